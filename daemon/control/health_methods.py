"""The methods ``health``, ``health.history`` and ``health.events``; all are read-only."""

from __future__ import annotations

from typing import Any

from daemon.control.rpc.params import number
from daemon.control.rpc.protocol import INVALID_PARAMS, Method, Role, RpcError
from daemon.monitoring.health.events import KEPT
from daemon.monitoring.health.quantities import BY_NAME, NAMES
from daemon.monitoring.health.sink import Health

MOST_SERIES, MOST_POINTS, LONGEST_S = 8, 600, 72 * 3600


class HealthMethods:
    """RPC methods of the health monitoring of one service."""

    def __init__(self, health: Health) -> None:
        self.health = health

    def table(self) -> dict[str, Method]:
        """Return every method by its name."""
        return {
            "health": Method(lambda _: self.health.report(), role=Role.VIEW),
            "health.history": Method(self.history, ("quantities", "seconds", "points"), role=Role.VIEW),
            "health.events": Method(self.events, ("most",), role=Role.VIEW),
        }

    def history(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the history of at most 8 ``quantities`` over ``seconds`` (3600) in at most 600 ``points`` (300).

        Each has ``mean``, ``low`` and ``high`` of every point, null where the quantity was unknown.
        """
        names = params.get("quantities")
        if not isinstance(names, list) or not 1 <= len(names) <= MOST_SERIES:
            raise RpcError(INVALID_PARAMS, f"quantities must be a list of 1 to {MOST_SERIES} names")
        for name in names:
            if not isinstance(name, str) or name not in BY_NAME:
                raise RpcError(INVALID_PARAMS, f"no quantity {name!r:.60}; there are {', '.join(NAMES)}")
        seconds = number(params, "seconds", 3600, 10, LONGEST_S)
        return self.health.time_series(names, seconds, int(number(params, "points", 300, 2, MOST_POINTS)))

    def events(self, params: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the newest events, at most ``most`` (100), in the order of their beginning."""
        most = int(number(params, "most", 100, 1, KEPT))
        return [event.as_dict() for event in self.health.events(most)]
