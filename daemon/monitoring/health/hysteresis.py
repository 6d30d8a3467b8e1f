"""Hysteresis of one limit: raised after a time beyond it, cleared after a time well within. Pure logic."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from daemon.config.sections.health import Health as Config

Change = Literal["raised", "cleared", "unknown"]

UNKNOWN_S = 60.0
"""An event ends when its quantity has been unknown for this long."""


@dataclass(slots=True)
class Hysteresis:
    """The state of one rule."""

    is_open: bool = False
    _since_s: float | None = field(default=None)
    _known_s: float = field(default=-math.inf)

    def feed(self, now_s: float, value: float, limit: float, config: Config, *, below: bool = False) -> Change | None:
        """Add the value of this second; return the change of state, if any.

        Args:
            now_s: monotonic; value: not negative, NaN = unknown; below: whether less than ``limit`` is bad.
        """
        if math.isnan(value):
            return self._unknown(now_s)
        self._known_s = now_s
        sign = -1.0 if below else 1.0
        margin = config.margin * abs(limit) if self.is_open else 0.0
        beyond = sign * value > sign * limit - margin
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
        if not self.is_open or now_s - self._known_s < UNKNOWN_S:
            return None
        self.is_open = False
        return "unknown"
