"""The projector as a camera that sees backwards: its marks, phases and residuals."""
