"""One limit without flicker: told after a while beyond it, taken back after a while well within. Pure logic."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from daemon.config.health import Health as Config

Change = Literal["raised", "cleared", "unknown"]

FORGET_S = 60.0
"""An event whose quantity has been unknown so long is over: it is neither ill nor well."""


@dataclass(slots=True)
class Hysteresis:
    """The state of one rule."""

    is_open: bool = False
    _since_s: float | None = field(default=None)
    _known_s: float = field(default=-math.inf)

    def feed(self, now_s: float, value: float, limit: float, config: Config, *, below: bool = False) -> Change | None:
        """Take the value of this second; what has changed by it.

        Args:
            now_s: never goes back; value: not negative, NaN = unknown; below: whether less than ``limit`` is bad.
        """
        if math.isnan(value):
            return self._unknown(now_s)
        self._known_s = now_s
        sign = -1.0 if below else 1.0
        room = config.margin * abs(limit) if self.is_open else 0.0
        beyond = sign * value > sign * limit - room
        if beyond is self.is_open:
            self._since_s = None
            return None
        self._since_s = now_s if self._since_s is None else self._since_s
        if now_s - self._since_s < (config.clear_s if self.is_open else config.raise_s):
            return None
        self.is_open, self._since_s = not self.is_open, None
        return "raised" if self.is_open else "cleared"

    def _unknown(self, now_s: float) -> Change | None:
        self._since_s = None
        if not self.is_open or now_s - self._known_s < FORGET_S:
            return None
        self.is_open = False
        return "unknown"
