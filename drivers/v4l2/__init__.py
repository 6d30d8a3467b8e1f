"""Cameras of the kernel's video interface (Video4Linux 2), by ioctl requests and mapped buffers."""

from drivers.v4l2.camera import V4l2Camera, open_camera
from drivers.v4l2.discovery import DetectedCamera, discover

__all__ = ["DetectedCamera", "V4l2Camera", "discover", "open_camera"]
