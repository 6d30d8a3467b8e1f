"""Trigger numbers of frames from the camera's own frame counter.

After each start the first frame is number 0, so two cameras that are started before the trigger pulses agree without
communication; should one miss the first pulse, their counts differ by a constant, which the pairing determines. A
camera whose counter restarts at each start (at 0, or at 1 in GigE Vision) is counted from there, so that even a lost
first frame leaves its gap.
"""

from __future__ import annotations

from collections import deque

from drivers.device_clock import period_ns
from drivers.protocols import TRIGGER_MODULUS

_RESTARTED_BELOW = 16
"""A count below this after a start means that the counter was restarted."""

_BLOCK_IDS = 1 << 16
_MOST_AFTER_WRAP = 1000
_STUCK_AFTER = 3
_HISTORY = 16


class TriggerNumbers:
    """Numbers the frames of one camera.

    Args:
        first_id: first count of a camera of this transport: 1 for GigE Vision, else 0.

    Attributes:
        gaps: frames that the camera counted and that never came. by_time: whether its count is unusable.
        resets: times that the count decreased.
    """

    def __init__(self, first_id: int = 0) -> None:
        self._first_id = first_id
        self.by_time = False
        self.gaps = self.resets = 0
        self._same = 0
        self._last_id: int | None = None
        self._restarts: bool | None = None
        self.start()

    def start(self) -> None:
        """Start a run: the next frame is the first one."""
        self._id_before, self._last_id = self._last_id, None
        self._number = -1
        self._times: deque[int] = deque(maxlen=_HISTORY)

    def number(self, frame_id: int | None, t_ns: int) -> int:
        """Return the trigger number of the next frame.

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
        step = self._step_by_time(t_ns) if self._is_stuck(frame_id) else self._step_by_id(frame_id or 0)
        self._last_id = frame_id
        self._times.append(t_ns)
        self._number += step
        return self._number % TRIGGER_MODULUS

    def _is_stuck(self, frame_id: int | None) -> bool:
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
        """Return the step to 0, or beyond it where a restarted count shows that frames were lost already."""
        if self._id_before is not None and self._restarts is None:
            self._restarts = frame_id <= self._id_before
        ahead = frame_id - self._first_id
        restarted = self._restarts or self._id_before is None
        return 1 + ahead if restarted and self._number < 0 and 0 <= ahead < _RESTARTED_BELOW else 1

    def _after_wrap(self, frame_id: int) -> int:
        """Return the step after a decrease: GigE Vision's short ids wrap from 65535 to 1, else it is a restart."""
        last = self._last_id or 0
        for modulus, skipped in ((_BLOCK_IDS, self._first_id), (1 << 32, 0), (1 << 64, 0)):
            step = frame_id + modulus - last - skipped
            if 0 < step < _MOST_AFTER_WRAP and last < modulus:
                return step
        self.resets += 1
        return 1

    def _step_by_time(self, t_ns: int) -> int:
        """Return one, or more where regular frames left a gap."""
        if not self._times:
            return 1
        period = period_ns(list(self._times))
        step = 1 if period is None else max(1, round((t_ns - self._times[-1]) / period))
        self.gaps += step - 1
        return step
