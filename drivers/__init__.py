"""Cameras and projectors: protocols and hardware. Nothing here knows of phases or clouds."""
