"""The projector as an inverse camera: its marks, absolute phases and residuals."""
