"""Projectors."""
from drivers.projector.listing import outputs
