"""Which trigger a frame belongs to, told by the camera's own count of frames.

After each start the first frame is number 0, so two cameras that are started before the pulses come agree without
talking to each other; should one miss the first pulse, their counts differ by a constant, which the pairing finds
out. A camera whose count begins anew at each start (at 0, or at 1 as GigE Vision has it) is counted from there, so
that even a lost first frame leaves its gap.
"""

from __future__ import annotations

from collections import deque

from drivers.device_clock import period_ns
from drivers.protocols import TRIGGER_MODULUS

_FRESH = 16
"""A count this low after a start has just begun."""

_BLOCK_IDS = 1 << 16
_WRAP_ROOM = 1000
_STUCK_AFTER = 3
_HISTORY = 16


class TriggerNumbers:
    """Numbers the frames of one camera.

    Args:
        first_id: where a camera of this transport begins to count: 1 for GigE Vision, else 0.

    Attributes:
        gaps: frames that the camera counted and that never came. by_time: whether its count is of no use.
        resets: times that the count went back.
    """

    def __init__(self, first_id: int = 0) -> None:
        self._first_id = first_id
        self.by_time = False
        self.gaps = self.resets = 0
        self._same = 0
        self._last_id: int | None = None
        self._begins_anew: bool | None = None
        self.start()

    def start(self) -> None:
        """The camera was started: the next frame is the first one."""
        self._id_before, self._last_id = self._last_id, None
        self._number = -1
        self._times: deque[int] = deque(maxlen=_HISTORY)

    def number(self, frame_id: int | None, t_ns: int) -> int:
        """The trigger of the next frame.

        Args:
            frame_id: the camera's count, None if it has none; t_ns: start of exposure or arrival.
        """
        if frame_id is None:
            self.by_time = True
        elif not self.by_time and frame_id == self._last_id:
            self._same += 1
            self.by_time = self._same >= _STUCK_AFTER
        elif frame_id != self._last_id:
            self._same, self.by_time = 0, False
        step = self._step_by_time(t_ns) if self._stands(frame_id) else self._step_by_id(frame_id or 0)
        self._last_id = frame_id
        self._times.append(t_ns)
        self._number += step
        return self._number % TRIGGER_MODULUS

    def _stands(self, frame_id: int | None) -> bool:
        return self.by_time or frame_id is None or frame_id == self._last_id

    def _step_by_id(self, frame_id: int) -> int:
        if self._last_id is None:
            step = self._first_step(frame_id)
        else:
            step = frame_id - self._last_id
            if step < 0:
                step = self._after_wrap(frame_id)
        self.gaps += step - 1
        return step

    def _first_step(self, frame_id: int) -> int:
        """To 0, or beyond it where a count that has just begun tells that frames were lost already."""
        if self._id_before is not None and self._begins_anew is None:
            self._begins_anew = frame_id <= self._id_before
        ahead = frame_id - self._first_id
        fresh = self._begins_anew or self._id_before is None
        return 1 + ahead if fresh and self._number < 0 and 0 <= ahead < _FRESH else 1

    def _after_wrap(self, frame_id: int) -> int:
        """GigE Vision's short block ids go from 65535 to 1; any other way back is a count that began anew."""
        last = self._last_id or 0
        for modulus, skipped in ((_BLOCK_IDS, self._first_id), (1 << 32, 0), (1 << 64, 0)):
            step = frame_id + modulus - last - skipped
            if 0 < step < _WRAP_ROOM and last < modulus:
                return step
        self.resets += 1
        return 1

    def _step_by_time(self, t_ns: int) -> int:
        """One, or more where regular frames left a hole."""
        if not self._times:
            return 1
        period = period_ns(list(self._times))
        step = 1 if period is None else max(1, round((t_ns - self._times[-1]) / period))
        self.gaps += step - 1
        return step
