"""Whether this machine's clock is synchronised, and its offset: from chrony, else the kernel, else systemd.

Without a source it is unknown, which raises no event.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path

from daemon.common.run_program import is_installed, run_program

_TIMESYNCD = Path("/run/systemd/timesync/synchronized")
_TIMEOUT_S = 5.0
_UNSYNC, _NANO, _ERROR = 0x40, 0x2000, 5  # STA_UNSYNC, STA_NANO, TIME_ERROR of adjtimex(2)


@dataclass(frozen=True, slots=True)
class ClockSync:
    """Synchronisation of the clock.

    Args:
        source: ``chrony``, ``kernel``, ``systemd``, empty where there is none.
        synchronised: None if unknown; offset_ms: against the time servers, None if unknown.
    """

    source: str = ""
    synchronised: bool | None = None
    offset_ms: float | None = None


def clock_sync() -> ClockSync:
    """Query the sources in order; takes milliseconds, at worst five seconds."""
    if is_installed("chronyc"):
        try:
            answer = run_program(["chronyc", "-c", "tracking"], _TIMEOUT_S)
            sync = chrony(answer.out) if answer.status == 0 else None
        except OSError:
            sync = None
        if sync is not None:
            return sync
    return kernel() or (ClockSync("systemd", True) if _TIMESYNCD.exists() else ClockSync())


def chrony(text: str) -> ClockSync | None:
    """Parse the comma-separated values of ``chronyc -c tracking``; None for another text."""
    fields = text.strip().split(",")
    try:
        offset_ms, leap = 1e3 * float(fields[4]), fields[13]
    except (IndexError, ValueError):
        return None
    synchronised = leap != "Not synchronised"
    return ClockSync("chrony", synchronised, offset_ms if synchronised else None)


class _Timex(ctypes.Structure):
    """The beginning of struct timex; the other fields are not used."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


def kernel() -> ClockSync | None:
    """Read the state of the kernel's clock (adjtimex); None where that is not permitted, as in a container."""
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    timex = _Timex()
    state = int(adjtimex(ctypes.byref(timex)))
    return None if state < 0 else from_timex(state, timex.status, timex.offset)


def from_timex(state: int, status: int, offset: int) -> ClockSync:
    """Interpret adjtimex: its result, status and offset (microseconds, or nanoseconds with STA_NANO)."""
    synchronised = state != _ERROR and not status & _UNSYNC
    per_ms = 1e6 if status & _NANO else 1e3
    return ClockSync("kernel", synchronised, offset / per_ms if synchronised else None)
