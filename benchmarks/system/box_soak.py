"""Soak test of the whole loop on emulated hardware: ``python -m benchmarks.system.box_soak --triggers 200000``.

A daemon measures a rig in a box (X server, projector window, emulated GenICam cameras) in fast lock-step, under random
faults of a seed: frames that are lost, broken, late or doubled, edges that one camera never sees, blackouts, and
cameras that are unplugged. Every pair is compared byte by byte with what was shown. The exit code is 1 when a pair is
wrong, a whole pair is missing without a fault to explain it, or something leaks.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.common.box_daemon import Daemon
from benchmarks.common.process_statistics import sample
from daemon.live.items import ImageSet, Pair
from drivers.protocols import SIDES
from sim.box.box import GENTL_DIR, Box
from sim.box.options import from_mapping
from sim.devices.faults import FaultKind

RATES = {
    "lost": 0.005,
    "late": 0.001,
    "duplicate": 0.005,
    "wrong_number": 0.0005,
    "blackout": 0.0005,
}
HARMLESS = (FaultKind.NONE, FaultKind.LATE, FaultKind.DUPLICATE)
_GROWTH_MIB = 16.0
# The threads of a camera that is found again take some MiB once, which few triggers do not outweigh.
_MEMORY_TRIGGERS = 4000
_WARM_UP_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class Usage:
    """Resources of the daemon and its child processes: own memory, open files, shared memory files, processes."""

    own_mib: float
    files: int
    shared: int
    processes: int


@dataclass(slots=True)
class Result:
    """Result of a soak; ``whole``: triggers without a fault on either side. ``usage``: by share of the run."""

    triggers: int = 0
    whole: int = 0
    pairs: int = 0
    wrong: int = 0
    unknown: int = 0
    clouds: int = 0
    seconds: float = 0.0
    losses: int = 0
    faults: dict[str, int] = field(default_factory=dict)
    outcomes: dict[str, dict[str, int]] = field(default_factory=dict)
    drops: dict[str, int] = field(default_factory=dict)
    usage: list[tuple[int, Usage]] = field(default_factory=list)

    @property
    def growth_mib(self) -> float:
        """Own memory of all processes at the end, less that after a fifth of the run."""
        steady = [usage.own_mib for at, usage in self.usage if at >= _WARM_UP_SHARE * self.triggers]
        return steady[-1] - steady[0] if steady else 0.0

    def problems(self) -> list[str]:
        """Reasons why the soak has failed; memory counts from 4,000 triggers on."""
        problems_ = [f"{self.wrong} wrong pairs"] if self.wrong else []
        problems_ += [f"{self.unknown} pairs with a frame that was never shown"] if self.unknown else []
        if self.triggers >= _MEMORY_TRIGGERS and self.growth_mib > _GROWTH_MIB:
            problems_.append(f"memory grew by {self.growth_mib:.1f} MiB, limit {_GROWTH_MIB:g}")
        steady = [usage for at, usage in self.usage if at >= _WARM_UP_SHARE * self.triggers]
        for name in ("files", "shared", "processes"):
            first, last = getattr(steady[0], name), getattr(steady[-1], name)
            if last > first + 2:
                problems_.append(f"{name} grew from {first} to {last}")
        return problems_


def usage() -> Usage:
    """Of this process and all below it."""
    own, files, count = 0.0, 0, 0
    for pid in _tree(os.getpid()):
        try:
            now = sample(pid, 0.0)
        except (OSError, KeyError):
            continue  # it has just ended
        own, files, count = own + now.own_mib, files + now.files, count + 1
    return Usage(own, files, len(list(Path("/dev/shm").iterdir())), count)


def _tree(pid: int) -> Iterator[int]:
    yield pid
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            children = (task / "children").read_text().split()
        except OSError:
            continue
        for child in children:
            yield from _tree(int(child))


@contextmanager
def box_of(options: argparse.Namespace) -> Iterator[Box]:
    """A tiny rig in lock-step whose cameras this process and its children can open."""
    faults = {"seed": options.seed, **RATES, "gone": options.gone}
    box_options = from_mapping(
        {
            "tcp": 0,
            "exposure_us": 100,
            "readout_us": 100,
            "tolerance_us": 200,
            "simulation": {"scene": "plane", "frames": 1, "layout": {"scale": options.scale}, "faults": faults},
        }
    )
    before = os.environ.get(GENTL_DIR)
    with Box(box_options, real_time=False) as box:
        os.environ[GENTL_DIR] = str(box.gentl_dir)
        try:
            yield box
        finally:
            os.environ.pop(GENTL_DIR)
            if before is not None:
                os.environ[GENTL_DIR] = before


def soak(options: argparse.Namespace) -> Result:
    """One run."""
    result = Result()
    with box_of(options) as box, Daemon(box, queue=1) as daemon:
        _measure_some(daemon, options.measured)
        world, started = box.world, time.monotonic()
        daemon.step_until_pair()
        result.whole = daemon.pair_check.counts["pairs"]
        gone = False
        every = max(1, options.triggers // 20)
        while world.triggers < options.triggers:
            faults = {side: box.options.simulation.faults.of(world.triggers, side).kind for side in SIDES}
            if gone and FaultKind.GONE not in faults.values():
                # The world puts the plug back with its next trigger; in lock-step it then waits for the daemon.
                world.replug()
                daemon.wait_armed(120)
            gone = FaultKind.GONE in faults.values()
            whole = all(kind in HARMLESS for kind in faults.values())
            result.whole += whole
            daemon.step_patiently(patience_s=0.05 if whole else 0.0)
            if world.triggers % every == 0:
                result.usage.append((world.triggers, usage()))
                if options.verbose:
                    print(f"{world.triggers} triggers, {daemon.pair_check.counts['pairs']} pairs", flush=True)
        status = daemon.service.status()
        result.seconds = time.monotonic() - started
    counts = daemon.pair_check.counts
    result.triggers, result.pairs, result.clouds = world.triggers, counts["pairs"], counts["clouds"]
    result.wrong, result.unknown = counts["wrong"], counts["unknown"]
    result.losses = sum(camera.losses for camera in status.cameras.values())
    result.outcomes = {side: dict(camera.fates) for side, camera in status.cameras.items()}
    result.drops = dict(status.drops)
    for (_, kind), count in sorted(world.ledger.counts.items()):
        if kind is not FaultKind.NONE:
            result.faults[str(kind)] = result.faults.get(str(kind), 0) + count
    return result


def _measure_some(daemon: Daemon, every: int) -> None:
    """Give the pipeline only one pair in so many, so that the processor is free for the acquisition."""
    offer, counter = daemon.service.worker.offer, itertools.count()

    def offer_some(pair: Pair | ImageSet) -> None:
        if next(counter) % every == 0:
            offer(pair)

    daemon.service.worker.offer = offer_some  # type: ignore[method-assign, assignment]


def describe(result: Result) -> str:
    """The result as text."""
    first, last = result.usage[0][1], result.usage[-1][1]
    lines = [
        f"{result.triggers} triggers in {result.seconds:.0f} s; {result.whole} whole, {result.pairs} pairs "
        f"({result.pairs / max(1, result.whole):.3%} of the whole), {result.wrong} wrong, {result.unknown} unknown, "
        f"{result.clouds} clouds",
        f"pipeline and sinks dropped: {result.drops}",
        f"faults: {dict(result.faults)}; cameras lost and found again: {result.losses}",
        *(f"outcomes {side}: {outcomes}" for side, outcomes in result.outcomes.items()),
        f"memory {first.own_mib:.0f} MiB -> {last.own_mib:.0f} MiB (settled growth {result.growth_mib:+.1f}), "
        f"files {first.files} -> {last.files}, shared memory {first.shared} -> {last.shared}, "
        f"processes {first.processes} -> {last.processes}",
    ]
    return "\n".join(lines + [f"PROBLEM: {problem}" for problem in result.problems()])


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.system.box_soak", description=__doc__)
    parser.add_argument("--triggers", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=0.0625, help="size of the images, 1 = 1024 x 820")
    parser.add_argument("--gone", type=float, default=5e-5, help="share of triggers at which a camera is unplugged")
    parser.add_argument("--measured", type=int, default=50, help="one pair in so many goes to the pipeline")
    parser.add_argument("--verbose", action="store_true", help="report progress")
    return parser.parse_args(given)


def main(given: list[str]) -> int:
    """Soak and report."""
    result = soak(arguments(given))
    print(describe(result))
    return 1 if result.problems() else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
