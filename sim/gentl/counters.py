"""State and counters of an emulated camera, read from the shared state."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class CableState:
    """State of a camera, and its counters since its cable was made.

    For every pulse on a line: ``exposed + missed + ignored + granted`` rises by one; and every exposure ends as one of
    ``delivered``, ``truncated``, ``too_small``, ``dropped``, ``no_buffer``, ``overrun``, ``overwritten`` or
    ``abandoned``.

    Args:
        present: plugged in; open_by: pid of the process that has it open, 0 if none.
        acquiring: between AcquisitionStart and its end; armed: the next pulse on the right line starts an exposure.
        exposure_us: the exposure time that is set; inside: frames between start of exposure and host.
        exposed: exposures started; delivered: whole frames in the host's GenTL queue.
        truncated: frames that lost their second half on the cable; too_small: did not fit the host's buffer.
        dropped: frames lost on the cable; no_buffer: the host had queued none; overrun: the camera's memory was full.
        abandoned: acquisition ended, or the camera was unplugged, before they were sent.
        missed: pulses during an exposure; ignored: pulses that the settings do not select; granted: pulses that
            started an acquisition or a burst rather than a frame.
        superseded: delivered frames that a newer one replaced before the host took them.
        overwritten: lost because their image was overwritten before the camera's process read it.
        image: number of the image exposed last.
    """

    present: bool
    open_by: int
    acquiring: bool
    armed: bool
    exposure_us: float
    inside: int
    exposed: int
    delivered: int
    truncated: int
    too_small: int
    dropped: int
    no_buffer: int
    overrun: int
    abandoned: int
    missed: int
    ignored: int
    granted: int
    superseded: int
    overwritten: int
    image: int


_COUNTERS = tuple(field.name for field in fields(CableState) if field.type == "int" and field.name != "open_by")


def read_state(state: np.void, open_by: int) -> CableState:
    """The state at this moment; the numbers are not read at the same instant."""
    values: dict[str, Any] = {name: int(state[name]) for name in _COUNTERS}
    values |= {name: bool(state[name]) for name in ("present", "acquiring", "armed")}
    return CableState(**values, open_by=open_by, exposure_us=int(state["exposure_ns"]) / 1e3)
