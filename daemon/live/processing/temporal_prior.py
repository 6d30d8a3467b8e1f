"""Whether the orders of the last measured pair may be used as the prior of the next one."""

from __future__ import annotations

from drivers.protocols import TRIGGER_MODULUS

_MAX_PERIODS = 4
_MIN_NS = 200_000_000  # a shorter time is close at any trigger rate


class TemporalPrior:
    """Remembers the last measured pair."""

    def __init__(self) -> None:
        self._last: tuple[int, int, int] | None = None

    def usable(self, seq: int, t_ns: int, stride: int) -> bool:
        """Whether a pair was exposed at most four trigger periods (or 0.2 s) after the last one.

        Args:
            seq: trigger number; t_ns: start of exposure; stride: spacing of the pixels to be measured, which must be
                that of the last pair.
        """
        if self._last is None:
            return False
        last_seq, last_ns, last_stride = self._last
        periods, passed_ns = (seq - last_seq) % TRIGGER_MODULUS, t_ns - last_ns
        if stride != last_stride or not 0 < periods < TRIGGER_MODULUS // 2 or passed_ns <= 0:
            return False
        return periods <= _MAX_PERIODS or passed_ns <= _MIN_NS

    def measured(self, seq: int, t_ns: int, stride: int) -> None:
        """Note that this pair has been measured."""
        self._last = seq, t_ns, stride

    def reset(self) -> None:
        """Use no prior for the next pair: settings changed, or a pair failed."""
        self._last = None
