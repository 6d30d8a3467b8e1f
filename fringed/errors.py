"""The errors of the client."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class FringedError(RuntimeError):
    """Base class of the client's errors."""


class ArgumentError(FringedError, ValueError):
    """An argument cannot be used: an address, a key, a time-out; the text names it, its value and what is expected."""


class WireError(FringedError):
    """A received message violates the stream's format; the text names the part."""


class CodecMissingError(WireError):
    """A part is compressed with a codec whose package is not installed."""


class SharedMemoryError(WireError):
    """The daemon's shared memory cannot be opened by this process."""


class OverwrittenError(WireError):
    """A newer cloud has replaced one in shared memory before it was read."""


class SilenceError(FringedError, TimeoutError):
    """No cloud was received within the time-out."""


class KeyFileError(FringedError):
    """A key file cannot be used; the text names file and line, never the key."""


class ControlError(FringedError):
    """A control request failed, or found no daemon."""


class NoDaemonError(ControlError, ConnectionError):
    """No daemon answers at an address, or it does not accept the key."""


class RefusedError(ControlError):
    """The daemon answered with an error.

    Args:
        code: of the protocol, such as -32602; path: of the setting or parameter; data: further members.
    """

    def __init__(self, message: str, *, code: int, data: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code, self.data = code, dict(data or {})

    @property
    def path(self) -> str | None:
        """The setting or parameter that the error concerns, if it names one."""
        path = self.data.get("path")
        return path if isinstance(path, str) else None


class RecordingError(FringedError):
    """A recording cannot be opened or read; the text names the file."""


class NotLiveError(FringedError):
    """A recording cannot do what only a running daemon can."""
