"""Figures of the documentation, drawn from measurements of the simulator; ``python -m tools.docs.figures``."""
