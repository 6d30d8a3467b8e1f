"""Cameras and projectors: protocols and hardware. Nothing here depends on phases or clouds."""
