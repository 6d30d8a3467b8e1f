"""Ordinary pairs for the refinement: of a take, or straight from a rig."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.apps.calibration.errors import SourceError
from daemon.live.items import Item, PairItem
from pipeline.calibrate.drift_correction import MOST_PAIRS, Pair
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.volume import Volume

_TIMEOUT_S = 180.0
_EVERY = 3  # of a live rig's pairs: scenes that differ tell more


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Pairs with what is needed to measure them."""

    pattern: ColorFringe
    volume: Volume
    encoding: str
    pairs: list[Pair]


def files_of_take(path: Path, progress: Callable[[int, int], None]) -> Scene:
    """Pairs spread over a take.

    Raises:
        TakeError: no take, or nothing attached; SourceError: pairs of several encodings, or none.
    """
    from daemon.recording.read.take_reader import TakeReader

    with TakeReader(path) as take:
        pattern, volume = take.pattern(), take.volume()
        every, pairs, encodings = 1, [], set()
        for number, pair in enumerate(take.pairs(lambda done: progress(done, take.size))):
            if number % every:
                continue
            pairs.append((pair.left, pair.right))
            encodings.add(pair.encoding)
            if len(pairs) > 2 * MOST_PAIRS:
                # Half of them, twice as far apart: spread over the whole take in bounded memory.
                pairs, every = pairs[::2], 2 * every
    return Scene(pattern, volume, encoding_of(encodings, str(path)), pairs)  # type: ignore[arg-type]


class _Keep:
    """A sink that keeps some pairs."""

    def __init__(self) -> None:
        self.pairs: list[Pair] = []
        self.encodings: set[str] = set()
        self.full = threading.Event()
        self._seen = 0

    def offer(self, item: Item) -> bool:
        if isinstance(item, PairItem) and not self.full.is_set():
            self._seen += 1
            if self._seen % _EVERY == 0:
                self.pairs.append((item.left.image, item.right.image))  # type: ignore[arg-type]
                self.encodings.add(item.left.encoding)
            if len(self.pairs) >= MOST_PAIRS:
                self.full.set()
        return True

    def close(self) -> None:
        pass

    def status(self) -> dict[str, Any]:
        return {}


def of_rig(path: Path, progress: Callable[[int, int], None], *, timeout_s: float = _TIMEOUT_S) -> Scene:
    """Pairs that a rig takes now; no daemon may be running on its devices.

    Raises:
        ConfigError: a rig file with a mistake; SourceError: too few pairs within the time.
    """
    from daemon.config import load_rig
    from daemon.live.service import Service
    from daemon.rig.open_rig import open_rig

    config = load_rig(path)
    rig = open_rig(config, path.resolve().parent)
    keep = _Keep()
    service = Service(config, rig, {"pairs": keep})
    failed: list[BaseException] = []

    def run() -> None:
        try:
            service.run()
        except BaseException as error:  # told in the caller's thread
            failed.append(error)
            keep.full.set()

    thread = threading.Thread(target=run, name="refine-rig", daemon=True)
    thread.start()
    try:
        waited = 0.0
        while waited < timeout_s and not keep.full.wait(0.25):
            waited += 0.25
            progress(len(keep.pairs), MOST_PAIRS)
    finally:
        service.ask_stop()
        thread.join(30.0)
    if failed:
        raise failed[0]
    if len(keep.pairs) < 2:
        raise SourceError(f"{path}: the rig gave {len(keep.pairs)} pairs of images within {timeout_s:.0f} s")
    return Scene(rig.pattern, rig.volume, encoding_of(keep.encodings, str(path)), keep.pairs)


def encoding_of(encodings: set[str], name: str) -> str:
    """The one encoding of all pairs; SourceError if there are several or none."""
    if len(encodings) != 1:
        raise SourceError(
            f"{name}: the images have the encodings {', '.join(sorted(encodings)) or '(no images)'}, expected one"
        )
    return next(iter(encodings))
