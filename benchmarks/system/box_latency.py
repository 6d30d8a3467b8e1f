"""Latency from the edge on the trigger lines to the cloud: ``python -m benchmarks.system.box_latency``.

A daemon measures a rig in a box at a steady rate: real drivers, real stream, and cameras whose frames are sent after
exposure and readout, as real ones are. Every time is taken where the event happens, on one machine, with one clock;
each frame is identified by its bytes.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections import defaultdict
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.box_daemon import Daemon
from benchmarks.common.tables import Table
from daemon.live.items import Item, Pair
from fringed import SilenceError, subscribe
from sim.box.box import GENTL_DIR, Box
from sim.box.exposure_ledger import Trigger
from sim.box.options import from_mapping
from sim.box.world import Lit
from sim.render.projection_transport import Counts
from sim.render.render_pair import Image
from tools.waiting import wait_until

STAGES = {
    "frame": "both frames in the cameras' processes",
    "pair": "pair in the daemon",
    "cloud": "cloud ready",
    "received": "cloud at a subscriber",
}
_PERCENTILES = (50, 99, 99.9)
_WARM_UP = 10
_EXPOSURES = 24
"""Exposures that are rendered beforehand and shown in turn, so that rendering does not compete with measuring."""


class Times:
    """Times of all stages by trigger, milliseconds after the edge; filled from several threads."""

    def __init__(self) -> None:
        self.ms: dict[str, dict[int, float]] = defaultdict(dict)
        self._edges: dict[int, tuple[int, int]] = {}
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def report(self, shown: Trigger, item: Item, now_ns: int) -> None:
        """Note the times of a pair or a cloud; called by the pair check."""
        if isinstance(item, Pair):
            host_ns = max(item.left.t_host_ns, item.right.t_host_ns) - self._offset_ns
            self._edges[item.left.trigger] = shown.index, shown.t_ns
            self._note("frame", shown, host_ns)
            self._note("pair", shown, now_ns)
        else:
            self._note("cloud", shown, now_ns)

    def received(self, seq: int) -> None:
        """Note that a subscriber has received the cloud of a trigger."""
        index, t_ns = self._edges[seq]
        self.ms["received"][index] = (time.monotonic_ns() - t_ns) / 1e6

    def _note(self, stage: str, shown: Trigger, at_ns: int) -> None:
        self.ms[stage][shown.index] = (at_ns - shown.t_ns) / 1e6


class RecordedScene:
    """A scene with some exposures rendered once: the same counts, noise of as many seeds in turn."""

    def __init__(self, stage: Lit) -> None:
        self._stage = stage
        self._exposures: dict[tuple[int, int], tuple[Image, Image]] = {}

    def counts(self, image: NDArray[np.uint8], instant: int = 0) -> Counts:
        """Both cameras' counts without noise."""
        return self._stage.counts(image, instant)

    def images(self, counts: Counts, seed: int) -> tuple[Image, Image]:
        """Both cameras' images with the noise of one of the seeds."""
        if not self._exposures.get((id(counts), 0)):
            for k in range(_EXPOSURES):
                self._exposures[id(counts), k] = self._stage.images(counts, k)
        return self._exposures[id(counts), seed % _EXPOSURES]


def measure(options: argparse.Namespace) -> Table:
    """One run and its table."""
    box_options = from_mapping(
        {
            "tcp": 0,
            "exposure_us": options.exposure_us,
            "readout_us": options.readout_us,
            "simulation": {"scene": "mixed", "frames": 1, "layout": {"scale": options.scale}, "rate_hz": options.rate},
        }
    )
    times = Times()
    with Box(box_options) as box:
        os.environ[GENTL_DIR] = str(box.gentl_dir)
        box.world.set_stage(RecordedScene(box.stage))
        with Daemon(box, report=times.report, temporal_prior=True) as daemon:
            daemon.step_until_pair()
            _run(box, daemon, times, options)
        late = box.world.late
    width, height = box_options.layout.camera_size
    table = Table(
        "box_latency",
        f"From the edge on the trigger lines, ms ({width} x {height} pixels, {options.rate:g} triggers a second)",
        ("until", *(f"P{p:g}" for p in _PERCENTILES), "longest", "count"),
    )
    for stage, name in STAGES.items():
        values = np.array([ms for index, ms in times.ms[stage].items() if index >= _WARM_UP])
        table.add(
            name, *(f"{np.percentile(values, p):.2f}" for p in _PERCENTILES), f"{values.max():.2f}", f"{len(values)}"
        )
    in_camera_ms = (options.exposure_us + options.readout_us) / 1e3
    table.notes.append(f"exposure and readout take {in_camera_ms:g} ms of it; triggers skipped by the emulator: {late}")
    table.notes.append(
        f"wrong pairs: {daemon.pair_check.counts['wrong']}; X server and cameras run on the same machine"
    )
    table.notes.append(
        "the pair check reads all bytes of each pair before it is measured; the clouds' times include that"
    )
    return table


def _run(box: Box, daemon: Daemon, times: Times, options: argparse.Namespace) -> None:
    stop, ended = threading.Event(), threading.Event()
    subscriber = threading.Thread(target=_subscribe, args=(daemon.stream, times, ended), name="subscriber")
    subscriber.start()
    try:
        wait_until(
            lambda: "cloud/full" in daemon.service.router.sinks["stream"].status()["topics"], 30, "the subscription"
        )
        triggers = threading.Thread(target=box.world.run, args=(options.rate, stop), name="triggers")
        triggers.start()
        try:
            wait_until(
                lambda: box.world.triggers >= options.count, 60 + 2 * options.count / options.rate, "the last trigger"
            )
        finally:
            stop.set()
            triggers.join(30)
        wait_until(lambda: daemon.pair_check.last_cloud >= box.world.triggers - 2, 30, "the last cloud")
    finally:
        ended.set()
        subscriber.join(30)


def _subscribe(endpoint: str, times: Times, ended: threading.Event) -> None:
    with closing(subscribe(endpoint, latest=False, timeout_s=0.5)) as clouds:
        while not ended.is_set():
            try:
                times.received(next(clouds).header.seq)
            except SilenceError:
                continue


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.system.box_latency", description=__doc__)
    parser.add_argument("--count", type=int, default=1500, help="triggers")
    parser.add_argument("--rate", type=float, default=20.0, help="triggers a second")
    parser.add_argument("--scale", type=float, default=0.25, help="size of the images, 1 = 1024 x 820")
    parser.add_argument("--exposure-us", type=float, default=2000.0)
    parser.add_argument("--readout-us", type=float, default=1000.0)
    return parser.parse_args(given)


def main(given: list[str]) -> int:
    """Measure and print."""
    from rich.console import Console

    table = measure(arguments(given))
    table.print(Console())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
