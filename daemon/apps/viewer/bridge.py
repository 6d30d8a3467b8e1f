"""Transfer of the newest stream messages to a Rerun recording, decimated, at a limited rate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from daemon.apps.viewer.colors import Color
from daemon.apps.viewer.rerun_log import Logger
from daemon.apps.viewer.stream_source import NewestMessages
from fringed import wire
from fringed.errors import WireError

_WAIT_S = 0.1


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the display.

    Args:
        decimate: stride of the rows and columns; rate_hz: most clouds per second.
        count, seconds: stop after this number of clouds or this time; None = never.
    """

    decimate: int = 2
    color: Color = "depth"
    rate_hz: float = 15.0
    count: int | None = None
    seconds: float | None = None


class Bridge:
    """Logs the messages of a stream; with a slow viewer it skips clouds and delays no other subscriber."""

    def __init__(self, source: NewestMessages, recording: Any, options: Options) -> None:
        self.clouds = 0
        self._source, self._options = source, options
        self._logger = Logger(recording, decimate=options.decimate, color=options.color)

    def run(self, stopped: Callable[[], bool] = lambda: False, now_s: Callable[[], float] = time.monotonic) -> None:
        """Log until ``stopped()``, ``count`` or ``seconds``."""
        options, start_s = self._options, now_s()
        due_s = start_s
        while not stopped():
            elapsed_s = now_s() - start_s
            if options.seconds is not None and elapsed_s >= options.seconds:
                return
            # Messages are received continuously and shown when due, so no shown message has waited in a queue.
            self._source.drain(_WAIT_S)
            if now_s() < due_s:
                continue
            if self.show_newest():
                due_s = now_s() + 1.0 / options.rate_hz
            if options.count is not None and self.clouds >= options.count:
                return

    def show_newest(self) -> bool:
        """Log the pending messages; returns whether there were any."""
        shown = False
        for message in self._source.newest():
            try:
                self._show(message)
            except WireError:
                self._source.damaged += 1
            shown = True
        return shown

    def _show(self, message: wire.Message) -> None:
        if message.topic.startswith("cloud/"):
            self._show_cloud(message)
            return
        self._logger.time(t_ns=message.header.t_ns)
        if message.topic == "preview":
            self._logger.images(message.arrays)
        else:
            self._logger.figures(_status_figures(message))

    def _show_cloud(self, message: wire.Message) -> None:
        header = message.header
        xyz, gray, sigma = (message.arrays.get(name) for name in ("xyz", "gray", "sigma"))
        if not isinstance(header, wire.CloudHeader) or xyz is None or gray is None or sigma is None:
            raise WireError(
                f"{message.topic}: it has the parts {', '.join(message.arrays)}, expected xyz, gray and sigma"
            )
        grid = (header.height, header.width)
        if xyz.shape != (*grid, 3) or gray.shape != grid or sigma.shape != grid:
            raise WireError(f"{message.topic}: the parts do not match the grid {header.width} x {header.height}")
        self._logger.time(seq=header.seq, t_ns=header.t_ns)
        rgb = message.arrays.get("rgb")
        if rgb is not None and rgb.shape != (*grid, 3):
            raise WireError(f"{message.topic}: rgb does not match the grid {header.width} x {header.height}")
        self._logger.cloud(xyz, gray, sigma, rgb)
        points = {"points": int(np.isfinite(xyz[..., 2]).sum())}
        self._logger.figures(points | _numbers({"latency_ms": header.stats.get("latency_ms")}))
        self.clouds += 1


def _status_figures(message: wire.Message) -> dict[str, float]:
    data = message.header.data if isinstance(message.header.data, dict) else {}
    drops = data.get("drops")
    total = sum(_numbers(drops).values()) if isinstance(drops, dict) else None
    return _numbers({"rate_hz": data.get("cloud_rate_hz"), "drops": total})


def _numbers(values: dict[str, Any]) -> dict[str, float]:
    """The numbers among the values; another version of the daemon may send other types."""
    return {name: value for name, value in values.items() if isinstance(value, int | float)}
