"""Ordinary pairs for the drift correction, read from a take or captured with a rig."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.apps.calibration.errors import SourceError
from daemon.live import items
from pipeline.calibrate.drift_correction import MOST_PAIRS, Pair
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.volume import Volume

_TIMEOUT_S = 180.0
_STRIDE = 3  # of a live rig's pairs: different scenes constrain the correction better


@dataclass(frozen=True, slots=True, eq=False)
class DriftPairs:
    """Pairs with what their measurement requires."""

    pattern: ColorFringe
    volume: Volume
    encoding: str
    pairs: list[Pair]


def from_take(path: Path, progress: Callable[[int, int], None]) -> DriftPairs:
    """Read pairs spread over a take.

    Raises:
        TakeError: no take, or no attachments; SourceError: pairs of several encodings, or none.
    """
    from daemon.recording.read.take_reader import TakeReader

    with TakeReader(path) as take:
        pattern, volume = take.pattern(), take.volume()
        stride, pairs, encodings = 1, [], set()
        for number, pair in enumerate(take.pairs(lambda done: progress(done, take.size))):
            if number % stride:
                continue
            pairs.append((pair.left, pair.right))
            encodings.add(pair.encoding)
            if len(pairs) > 2 * MOST_PAIRS:
                # Half of the pairs at twice the stride: the whole take in bounded memory.
                pairs, stride = pairs[::2], 2 * stride
    return DriftPairs(pattern, volume, encoding_of(encodings, str(path)), pairs)  # type: ignore[arg-type]


class _PairSink:
    """A sink that keeps every third pair."""

    heartbeat = None

    def __init__(self) -> None:
        self.pairs: list[Pair] = []
        self.encodings: set[str] = set()
        self.full = threading.Event()
        self._count = 0

    def offer(self, item: items.Item) -> bool:
        if isinstance(item, items.Pair) and not self.full.is_set():
            self._count += 1
            if self._count % _STRIDE == 0:
                self.pairs.append((item.left.image, item.right.image))  # type: ignore[arg-type]
                self.encodings.add(item.left.encoding)
            if len(self.pairs) >= MOST_PAIRS:
                self.full.set()
        return True

    def close(self) -> None:
        pass

    def status(self) -> dict[str, Any]:
        return {}


def from_rig(path: Path, progress: Callable[[int, int], None], *, timeout_s: float = _TIMEOUT_S) -> DriftPairs:
    """Capture pairs with a rig whose devices no daemon uses.

    Raises:
        ConfigError: a rig file with a mistake; SourceError: too few pairs within ``timeout_s``.
    """
    from daemon.config import load_rig
    from daemon.live.service import Service
    from daemon.rig.open_rig import open_rig

    config = load_rig(path)
    rig = open_rig(config, path.resolve().parent)
    sink = _PairSink()
    service = Service(config, rig, {"pairs": sink})
    failed: list[BaseException] = []

    def run() -> None:
        try:
            service.run()
        except BaseException as error:  # raised again in the caller's thread
            failed.append(error)
            sink.full.set()

    thread = threading.Thread(target=run, name="refine-rig", daemon=True)
    thread.start()
    try:
        waited = 0.0
        while waited < timeout_s and not sink.full.wait(0.25):
            waited += 0.25
            progress(len(sink.pairs), MOST_PAIRS)
    finally:
        service.request_stop()
        thread.join(30.0)
    if failed:
        raise failed[0]
    if len(sink.pairs) < 2:
        raise SourceError(
            f"{path}: the rig gave {len(sink.pairs)} pairs of images within {timeout_s:.0f} s, at least 2 are "
            f"required; `fringed doctor {path}` examines it"
        )
    return DriftPairs(rig.pattern, rig.volume, encoding_of(sink.encodings, str(path)), sink.pairs)


def encoding_of(encodings: set[str], name: str) -> str:
    """The one encoding of all pairs; SourceError if there are several or none."""
    if len(encodings) != 1:
        raise SourceError(
            f"{name}: the images have the encodings {', '.join(sorted(encodings)) or '(no images)'}, expected one"
        )
    return next(iter(encodings))
