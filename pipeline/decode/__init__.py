"""From raw image to phase map."""
