"""A camera in a process of its own: commands over a socket, frames in shared memory."""

from drivers.remote.camera import RemoteCamera

__all__ = ["RemoteCamera"]
