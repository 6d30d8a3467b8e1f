"""The way of pairs, unpaired frames and clouds: to a capture, to the set of a mode, or to the worker and every sink."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping

from daemon.common.counters import Counters
from daemon.live.items import CloudItem, Item, Pair, PartsReader, Sink, UnpairedFrame
from daemon.live.projection.mode_controller import ModeController
from drivers.protocols import Frame

log = logging.getLogger("fringed")

_KINDS: dict[type, str] = {Pair: "pairs", UnpairedFrame: "frames", CloudItem: "clouds"}


class Router:
    """Calls the consumers of each item, one item at a time for each producer.

    Args:
        sinks: by name. drops: counts what a sink rejects, under its name.
    """

    def __init__(self, sinks: Mapping[str, Sink], drops: Counters) -> None:
        self.sinks: dict[str, Sink] = dict(sinks)
        self._drops = drops
        self._sinks_lock = threading.Lock()
        #: Takes every pair instead of the worker and the sinks, if set.
        self.diversion: Callable[[Pair], object] | None = None

    def connect(self, mode_controller: ModeController, measure: Callable[[Pair], object]) -> None:
        """Name the consumers that need the router themselves; called once, before the first pair."""
        self._mode_controller, self._measure = mode_controller, measure

    def pair(self, pair: Pair) -> None:
        """Route a pair."""
        diversion = self.diversion
        if diversion is not None:
            diversion(pair)
        elif not self._mode_controller.accept(pair):
            self.emit(pair)
            self._measure(pair)

    def unpaired(self, frame: Frame) -> None:
        """Route a frame whose partner is missing."""
        if self.diversion is None and not self._mode_controller.hides_unpaired:
            self.emit(UnpairedFrame(frame))

    def emit(self, item: Item) -> None:
        """Offer an item to every sink; what a sink rejects is counted under its name."""
        for name, sink in self.sinks.items():
            try:
                if not sink.offer(item):
                    self._drops.add(f"{_KINDS[type(item)]}_{name}_busy")
            except Exception:  # a sink's bug must not appear as a camera's or the pipeline's
                self._drops.add(f"{_KINDS[type(item)]}_{name}_failed")
                log.exception("%s cannot take an item", name)

    def wanted_parts(self) -> frozenset[str]:
        """Parts of a cloud that any sink needs beside those that every cloud has."""
        wanted: frozenset[str] = frozenset()
        for sink in self.sinks.values():
            if isinstance(sink, PartsReader):
                wanted |= sink.wanted_parts()
        return wanted

    def add_sink(self, name: str, sink: Sink) -> None:
        """Offer every item to this sink too."""
        with self._sinks_lock:
            self.sinks = self.sinks | {name: sink}

    def remove_sink(self, name: str) -> Sink | None:
        """Offer nothing more to a sink; the caller closes it."""
        with self._sinks_lock:
            sink = self.sinks.get(name)
            self.sinks = {other: s for other, s in self.sinks.items() if other != name}
        return sink
