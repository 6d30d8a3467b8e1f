"""Rates and shares over the last seconds, from counters that only grow."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

UNMEASURED = ("pairs_pipeline_busy", "pairs_refused_by_pipeline", "pairs_failed_in_pipeline")
"""Reasons for which a pair has no cloud, except starting and stopping."""

_KEPT = 70
_PAIRED, _NO_OUTCOME = "paired", ("waiting", "stopped")


class CounterRates:
    """Keeps the counts of the last minute, second by second."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, dict[str, int]]] = deque(maxlen=_KEPT)

    def add(self, now_s: float, status: Mapping[str, Any]) -> None:
        """Add the counts of a status."""
        self._rows.append((now_s, _counts(status)))

    def over(self, now_s: float, window_s: float) -> tuple[float, dict[str, int]]:
        """Return the seconds since the oldest counts inside the window, and the increase of each count since then."""
        rows = [row for row in self._rows if row[0] >= now_s - window_s - 0.5]
        if len(rows) < 2:
            return 0.0, {}
        (began_s, before), (ended_s, after) = rows[0], rows[-1]
        return ended_s - began_s, {name: count - before.get(name, 0) for name, count in after.items()}

    def values(self, now_s: float, window_s: float) -> dict[str, float]:
        """Return the shares and rates of the table of quantities; unknown ones are left out."""
        seconds, grown = self.over(now_s, window_s)
        if seconds <= 0:
            return {}
        out: dict[str, float] = {}
        lost = sum(grown.get(f"drop:{name}", 0) for name in UNMEASURED)
        if (pairs := max(grown.get("pairs", 0), lost)) > 0:
            out["dropped_share"] = lost / pairs
        outcomes = {n: count for n, count in grown.items() if n.startswith("outcome:") and not n.endswith(_NO_OUTCOME)}
        if (frames := sum(outcomes.values())) > 0:
            out["lone_share"] = sum(count for name, count in outcomes.items() if not name.endswith(_PAIRED)) / frames
        refused = [
            n for n, count in grown.items() if count and n.startswith("drop:") and n.endswith(("_busy", "_failed"))
        ]
        out["refused_hz"] = sum(grown[name] for name in refused if name != f"drop:{UNMEASURED[0]}") / seconds
        return out

    def drops(self, now_s: float, window_s: float) -> dict[str, float]:
        """Return the drops a second by reason, without zeros."""
        seconds, grown = self.over(now_s, window_s)
        drops = {name.removeprefix("drop:"): n for name, n in grown.items() if name.startswith("drop:") and n}
        return {name: round(count / seconds, 3) for name, count in drops.items()}


def _counts(status: Mapping[str, Any]) -> dict[str, int]:
    counts = {"pairs": int(status["pairs"]), "clouds": int(status["clouds"])}
    counts |= {f"drop:{name}": count for name, count in status["drops"].items()}
    for side, camera in status["cameras"].items():
        counts |= {f"outcome:{side}:{name}": count for name, count in camera["fates"].items()}
    return counts
