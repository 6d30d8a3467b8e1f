"""The errors of the client."""

from __future__ import annotations


class FringedError(RuntimeError):
    """Base class of the client's errors."""


class WireError(FringedError):
    """A received message violates the stream's format; the text names the part."""


class CodecMissingError(WireError):
    """A part is compressed with a codec whose package is not installed."""


class SilenceError(FringedError, TimeoutError):
    """No cloud was received within the time-out."""


class KeyFileError(FringedError):
    """A key file cannot be used; the text names file and line, never the key."""
