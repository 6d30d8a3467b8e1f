"""Reprocessing against a plain replay, its scaling and overhead; a simulation of larger clusters with these figures.

    python -m benchmarks.system.reprocess [--pairs 120] [--folder DIR]

The take holds full-size pairs, rendered once. Clouds are computed and not written, so that the disk is not measured.
"""

from __future__ import annotations

import argparse
import heapq
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import yaml

from daemon.apps.reprocess.engine.dask_engine import DaskEngine, local_cluster
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.plan.recordings import recordings_of
from daemon.apps.reprocess.run import Run
from daemon.cli.allocator import worker_environment
from daemon.live.items import Pair
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame, Side
from sim.render.render_pair import render_images
from sim.rig import rig_files
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

SCENES = "plane", "spheres", "face", "mixed"
CHUNK = 16


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=120)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=Path(".bench-reprocess"))
    options = parser.parse_args()
    take = make_take(options.folder, options.pairs)
    found: dict[str, list[Figures]] = {"replay, 2 threads": [], "1 worker of 1 thread": [], "2 workers of 1 thread": []}
    with engine_of(1) as one, engine_of(2) as two:
        for engine in (one, two):
            reprocess_figures(take, engine, options.folder)  # loads the kernels
        for _ in range(options.rounds):  # in turn, for the load of the machine changes
            found["replay, 2 threads"].append(replay_figures(take))
            found["1 worker of 1 thread"].append(reprocess_figures(take, one, options.folder))
            found["2 workers of 1 thread"].append(reprocess_figures(take, two, options.folder))
        empty_ms = min(empty_task_ms(two) for _ in range(options.rounds))
    print(f"best of {options.rounds} rounds of {options.pairs} pairs; processor time: least")
    best = {name: max(one.rate for one in rows) for name, rows in found.items()}
    for name, rows in found.items():
        print(f"{name:24} {best[name]:6.2f} pairs/s {min(one.cpu_ms for one in rows):7.1f} ms of processor time a pair")
    replay, single, double = best.values()
    print(f"2 workers against replay: {double / replay:.3f}; 1 -> 2 workers: {double / single:.3f}")
    rest_ms = min(one.rest_ms for one in found["1 worker of 1 thread"])
    print(f"chunk of {CHUNK}: {rest_ms:.1f} ms besides reconstruction; task without work: {empty_ms:.2f} ms")
    print_simulation(1000 / single, empty_ms)


@dataclass(frozen=True, slots=True)
class Figures:
    """Pairs a second, processor time of a pair, and time of a chunk besides reconstruction, ms."""

    rate: float
    cpu_ms: float
    rest_ms: float = 0.0


def make_take(folder: Path, pairs: int) -> Path:
    """A take of full size; scenes in turn."""
    path = folder / f"take{pairs}.mcap"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    layout, optics = RigLayout(), Optics()
    images = [render_images(layout, build(name), layout.pattern(), optics) for name in SCENES]
    calibration = yaml.safe_dump(rig_files.calibration_mapping(layout, optics), sort_keys=False).encode()
    writer = TakeWriter(
        path, session="bench", device="sim", calibration_data=calibration, pattern=rig_files.pattern_mapping(layout),
        volume=rig_files.volume_mapping(layout), min_free_bytes=0, queue=pairs + 1,
    )  # fmt: skip
    sides: tuple[Side, Side] = ("left", "right")
    for number in range(pairs):
        t_ns = 1_790_000_000_000_000_000 + 33_000_000 * number
        left, right = (
            Frame(side, number, t_ns, t_ns + 10_000_000, "rgb8", image)
            for side, image in zip(sides, images[number % len(images)], strict=True)
        )
        writer.offer(Pair(left, right))
    writer.close()
    return path


_REPLAY = """
import sys, time
from pathlib import Path
from daemon.cli.allocator import prepare
prepare()
from daemon.apps.replay.runner import Replay
from daemon.recording.read.take_reader import TakeReader
with TakeReader(Path(sys.argv[1])) as take:
    ends = [(time.perf_counter(), time.process_time()) for _ in Replay(take).results()]
(start_s, start_cpu_s), (end_s, end_cpu_s) = ends[0], ends[-1]
print((len(ends) - 1) / (end_s - start_s), 1000 * (end_cpu_s - start_cpu_s) / (len(ends) - 1))
"""


def replay_figures(take: Path) -> Figures:
    """A replay from its first cloud to its last, reading included, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", _REPLAY, str(take)], capture_output=True, text=True, check=True)
    return Figures(*map(float, done.stdout.split()))


@contextmanager
def engine_of(workers: int) -> Iterator[DaskEngine]:
    """A local cluster."""
    with local_cluster(workers, worker_environment(1)) as engine:
        yield engine


def reprocess_figures(take: Path, engine: DaskEngine, folder: Path) -> Figures:
    """A run from its start to its end, planning and summary included."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    run = Run(Job(kind="", chunk_pairs=CHUNK), out, engine)
    run.run(recordings_of([str(take)]))
    rest, cpu = [], []
    for path in (out / take.stem / "chunks").glob("*.json"):
        manifest = json.loads(path.read_text())
        if len(manifest["rows"]) == CHUNK:
            rest.append(1000 * manifest["seconds"] - sum(row["total_ms"] for row in manifest["rows"]))
            cpu.append(1000 * manifest["cpu_seconds"] / CHUNK)
    return Figures(run.totals.computed / run.seconds, median(cpu), median(rest))


def nothing(_: Any) -> None:
    """A task without work."""


def empty_task_ms(engine: DaskEngine, tasks: int = 500) -> float:
    """Milliseconds that client and scheduler need for a task, when they are the limit."""
    start_s, left = time.perf_counter(), tasks
    for number in range(tasks):
        engine.submit(number, nothing, number)
    while left:
        left -= len(engine.wait(1.0))
    return 1000 * (time.perf_counter() - start_s) / tasks


def print_simulation(pair_ms: float, task_ms: float) -> None:
    """Efficiency of clusters of other sizes: workers as fast as these, tasks that pass one scheduler in turn."""
    print(f"simulated efficiency, {pair_ms:.0f} ms a pair and {task_ms:.2f} ms of client and scheduler a task:")
    print("workers " + "".join(f"{f'chunk {chunk}':>10}" for chunk in (1, 4, 16, 64)))
    for workers in (1, 2, 4, 8, 16, 32, 64, 256):
        cells = (simulated(workers, chunk, pair_ms, task_ms) for chunk in (1, 4, 16, 64))
        print(f"{workers:7} " + "".join(f"{100 * cell:9.1f}%" for cell in cells))


def simulated(workers: int, chunk: int, pair_ms: float, task_ms: float, pairs: int = 108_000) -> float:
    """Share of the workers' time that is reconstruction, for one hour at 30 pairs a second, the first pair alone."""
    first_ms = task_ms + pair_ms
    free, central = [first_ms] * workers, first_ms
    left = pairs - 1
    end = first_ms
    while left:
        n = min(chunk, left)
        left -= n
        ready = heapq.heappop(free)
        central = max(central, ready - 2 * n * pair_ms) + task_ms  # two more tasks wait at every worker
        end = max(end, max(ready, central) + n * pair_ms)
        heapq.heappush(free, max(ready, central) + n * pair_ms)
    return pairs * pair_ms / (workers * end)


if __name__ == "__main__":
    main()
