"""The methods ``health``, ``health.history`` and ``health.events``; all of them only look."""

from __future__ import annotations

from typing import Any

from daemon.control.rpc.protocol import INVALID_PARAMS, Method, Role, RpcError
from daemon.monitoring.health.events import KEPT
from daemon.monitoring.health.quantities import BY_NAME, NAMES
from daemon.monitoring.health.sink import Health

MOST_SERIES, MOST_POINTS, LONGEST_S = 8, 600, 72 * 3600


class HealthMethods:
    """Methods over the health of one service."""

    def __init__(self, health: Health) -> None:
        self.watch = health

    def table(self) -> dict[str, Method]:
        """Every method by its name."""
        return {
            "health": Method(lambda _: self.watch.report(), role=Role.VIEW),
            "health.history": Method(self.history, ("quantities", "seconds", "points"), role=Role.VIEW),
            "health.events": Method(self.events, ("most",), role=Role.VIEW),
        }

    def history(self, params: dict[str, Any]) -> dict[str, Any]:
        """Courses over the last ``seconds`` (3600): ``quantities``, at most 8; ``points``, at most 600 pieces (300).

        Each has ``mean``, ``low`` and ``high`` of every piece, null where nothing is known.
        """
        names = params.get("quantities")
        if not isinstance(names, list) or not 1 <= len(names) <= MOST_SERIES:
            raise RpcError(INVALID_PARAMS, f"quantities must be a list of 1 to {MOST_SERIES} names")
        for name in names:
            if not isinstance(name, str) or name not in BY_NAME:
                raise RpcError(INVALID_PARAMS, f"no quantity {name!r:.60}; there are {', '.join(NAMES)}")
        seconds = _number(params, "seconds", 3600, 10, LONGEST_S)
        return self.watch.courses(names, seconds, int(_number(params, "points", 300, 2, MOST_POINTS)))

    def events(self, params: dict[str, Any]) -> list[dict[str, Any]]:
        """The newest events, at most ``most`` (100), in the order of their beginning."""
        most = int(_number(params, "most", 100, 1, KEPT))
        return [event.as_dict() for event in self.watch.events(most)]


def _number(params: dict[str, Any], key: str, default: float, least: float, most: float) -> float:
    value = params.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise RpcError(INVALID_PARAMS, f"{key} must be a number from {least:g} to {most:g}")
    return float(value)
