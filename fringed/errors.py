"""What can go wrong for a subscriber, each with a name to catch."""

from __future__ import annotations


class FringedError(RuntimeError):
    """Root of the client's errors."""


class WireError(FringedError):
    """A message that does not follow the stream's format; the message tells where."""


class CodecMissingError(WireError):
    """A part is compressed with a codec whose package is not installed."""


class SilenceError(FringedError, TimeoutError):
    """No cloud came within the time-out."""


class KeyFileError(FringedError):
    """A key file that cannot be used; the message tells file and line, never the key."""
