"""Latency from the trigger to the cloud in a subscriber of another process, alone and under load.

``python -m benchmarks.latency --rates 10 15 30 --scales 1 0.5 --seconds 40``: for every size and rate a daemon measures
a simulated rig whose images are played. A subscriber takes whole clouds and notes for each the time since the start of
exposure. Rounds in which it is the only one alternate with rounds under load: a take is recorded, and seven more
subscribers read, of which one is stopped and one takes two clouds a second; those run at idle priority, as on a rig PC
they would run elsewhere. The exit code is 1 when P99 grows by more than a tenth.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.common.daemon_process import DaemonProcess
from benchmarks.common.process_statistics import sample
from benchmarks.common.tables import Table, write_whole
from benchmarks.load.clients import LoadClients
from benchmarks.soak.report import percentiles

LOADS = "alone", "8 subscribers, recorder"
OTHERS = {"full": 3, "light": 2, "slow": 1, "stopped": 1}
MOST_RATIO = 1.1
"""P99 under load to P99 alone, at most."""
_WARM_CLOUDS, _SETTLE_S = 20, 2.0
_SHARES = ("p50", "p99", "p999", "max")


@dataclass(slots=True)
class Rounds:
    """What was measured in all rounds of one kind.

    Args:
        received_ms, finished_ms: from the start of exposure to the subscriber, and to the finished cloud in the daemon.
        reading_s: from the first to the last cloud of the subscriber.
        pairs, clouds, seconds: of the daemon in that time; cpu_s: its processor time by thread.
        drops: items that were dropped, by reason; recorded: pairs in the take.
    """

    received_ms: list[float] = field(default_factory=list)
    finished_ms: list[float] = field(default_factory=list)
    reading_s: float = 0.0
    pairs: int = 0
    clouds: int = 0
    seconds: float = 0.0
    cpu_s: Counter[str] = field(default_factory=Counter)
    drops: Counter[str] = field(default_factory=Counter)
    recorded: int = 0

    def cpu_ms(self, thread: str) -> float:
        """Processor time of a thread for each cloud."""
        return 1e3 * self.cpu_s[thread] / max(1, self.clouds)

    def dropped(self) -> float:
        """Share of the pairs that became no cloud."""
        count = sum(count for reason, count in self.drops.items() if reason.startswith("pairs_"))
        return count / max(1, self.pairs)


Found = dict[tuple[float, float], tuple[Rounds, Rounds]]
"""By scale and rate: alone, and under load."""


def read(endpoint: str, seconds: float, *, shared: bool) -> None:
    """Print the time to here and the time to the finished cloud of every cloud, ms, as JSON; in another process."""
    from fringed import subscribe

    found: list[tuple[float, float]] = []
    began_s = passed_s = 0.0
    for cloud in subscribe(endpoint, topic="cloud/full", shared=shared):
        now_ns, now_s = time.time_ns(), time.monotonic()
        if not began_s:  # this one may have waited for the connection
            began_s = now_s
            continue
        found.append(((now_ns - cloud.header.t_ns) / 1e6, cloud.header.stats["latency_ms"]))
        passed_s = now_s - began_s
        if passed_s > seconds:
            break
    print(json.dumps({"seconds": passed_s, "ms": found}))


def rig(directory: Path, scale: float, rate: float, frames: int) -> dict[str, Any]:
    """The content of rig.yaml."""
    layout = {} if scale == 1 else {"layout": {"scale": scale}}
    return {
        "cameras": {"driver": "sim"},
        "simulation": {"scene": "moving", "frames": frames, "rate_hz": rate, **layout},
        "pipeline": {"overload": "skip"},
        "stream": {"endpoints": [f"ipc://{directory}/stream"]},
        "control": {"endpoint": f"ipc://{directory}/control"},
        "recording": {"dir": str(directory / "takes"), "max_part_mb": 1024},
    }


def measure(options: argparse.Namespace, scale: float, rate: float, directory: Path) -> tuple[Rounds, Rounds]:
    """Rounds alone and under load, in turn, with one daemon."""
    content, path = rig(directory, scale, rate, options.frames), directory / "rig.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")  # JSON is YAML
    stream, control = content["stream"]["endpoints"][0], content["control"]["endpoint"]
    alone, loaded = Rounds(), Rounds()
    with DaemonProcess(path, control, directory / "log") as daemon:
        daemon.until(lambda status: status["clouds"] > _WARM_CLOUDS, 900.0, "clouds")
        for _ in range(options.rounds):
            _round(daemon, stream, options, alone)
            with ExitStack() as load:
                daemon.ask("record.start", timeout_s=30.0, name="latency")
                load.callback(daemon.ask, "record.stop", timeout_s=60.0)
                load.enter_context(LoadClients(stream, control, OTHERS, shared=options.shared))
                _round(daemon, stream, options, loaded)
            for part in (directory / "takes").glob("*.mcap*"):
                part.unlink()
    return alone, loaded


def _round(daemon: DaemonProcess, stream: str, options: argparse.Namespace, into: Rounds) -> None:
    time.sleep(_SETTLE_S)
    before, first, began_s = daemon.ask("status"), sample(daemon.pid, 0.0), time.monotonic()
    command = [sys.executable, "-m", "benchmarks.latency", "--read", stream, "--seconds", str(options.seconds)]
    command += ["--shared"] if options.shared else []
    result = subprocess.run(command, stdout=subprocess.PIPE, timeout=options.seconds + 120, check=True)
    after, last = daemon.ask("status", timeout_s=30.0), sample(daemon.pid, 1.0)
    into.seconds += time.monotonic() - began_s
    read = json.loads(result.stdout)
    into.reading_s += read["seconds"]
    into.received_ms += [received for received, _ in read["ms"]]
    into.finished_ms += [finished for _, finished in read["ms"]]
    into.pairs += after["pairs"] - before["pairs"]
    into.clouds += after["clouds"] - before["clouds"]
    into.cpu_s += Counter(last.cpu_s) - Counter(first.cpu_s)
    into.drops += Counter(after["drops"]) - Counter(before["drops"])
    into.recorded += after["recorder"].get("pairs", 0)


def tables(found: Found) -> list[Table]:
    """Latencies, and what limits them: processor time by thread."""
    latency = Table(
        "latency", "From the start of exposure to the cloud in a subscriber of another process, ms",
        ["scale", "triggers a second", "load", "clouds a second", *_SHARES, "P99 to alone", "finished p50", "p99",
         "pairs dropped %"],
        text_columns=("load",),
    )  # fmt: skip
    every = [one for pair in found.values() for one in pair]
    threads = sorted({name for one in every for name in one.cpu_s})
    shown = [name for name in threads if any(one.cpu_ms(name) >= 0.5 for one in every)]
    processors = len(os.sched_getaffinity(0))
    cpu = Table(
        "latency threads", f"Processor time for each cloud by thread of the daemon, ms; {processors} processors",
        ["scale", "triggers a second", "load", *shown, "all", "processors busy %"], text_columns=("load",),
    )  # fmt: skip
    for (scale, rate), pair in found.items():
        for load, one in zip(LOADS, pair, strict=True):
            row = f"{scale:g}", f"{rate:g}", load
            received, finished = percentiles(one.received_ms), percentiles(one.finished_ms)
            values = [f"{received[share]:.1f}" for share in _SHARES] if received else [""] * len(_SHARES)
            latency.add(
                *row, f"{len(one.received_ms) / max(one.reading_s, 1e-9):.1f}", *values, f"{p99_ratio(pair, one):.2f}",
                *(f"{finished.get(share, 0.0):.1f}" for share in ("p50", "p99")), f"{100 * one.dropped():.1f}",
            )  # fmt: skip
            busy = one.cpu_s.total() / max(one.seconds, 1e-9) / processors
            total = 1e3 * one.cpu_s.total() / max(1, one.clouds)
            cpu.add(*row, *(f"{one.cpu_ms(name):.1f}" for name in shown), f"{total:.1f}", f"{100 * busy:.0f}")
    latency.notes.append(f"Rounds in turn; {LOADS[1]}: see python -m benchmarks.latency --help.")
    cpu.notes.append("The daemon plays the simulated images too; the subscribers are not in it.")
    return [latency, cpu]


def p99_ratio(pair: tuple[Rounds, Rounds], one: Rounds) -> float:
    """P99 of these rounds to that of the rounds alone; 0 without clouds."""
    alone, here = percentiles(pair[0].received_ms), percentiles(one.received_ms)
    return here["p99"] / alone["p99"] if alone and here else 0.0


def faults(found: Found) -> list[str]:
    """Sizes and rates at which the load adds more than a tenth to P99, or at which no cloud came."""
    texts = []
    for (scale, rate), pair in found.items():
        ratio = p99_ratio(pair, pair[1])
        if not 0 < ratio <= MOST_RATIO:
            texts.append(f"scale {scale:g} at {rate:g} a second: P99 under load is {ratio:.2f} of that alone")
    return texts


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description=__doc__)
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 15.0, 30.0], help="triggers a second")
    parser.add_argument("--scales", type=float, nargs="+", default=[1.0, 0.5], help="of the images, 1 = 1024 x 820")
    parser.add_argument("--seconds", type=float, default=40.0, help="of a round")
    parser.add_argument("--rounds", type=int, default=2, help="of each kind")
    parser.add_argument("--frames", type=int, default=12, help="images in the loop that is played")
    parser.add_argument("--dir", type=Path, help="where the takes are written; some GB (default: temporary directory)")
    parser.add_argument("--out", type=Path, default=Path("out"), help="directory of latency.json")
    parser.add_argument("--shared", action="store_true", help="subscribers read whole clouds from shared memory")
    parser.add_argument("--read", help=argparse.SUPPRESS)
    return parser.parse_args(given)


def main(given: list[str]) -> int:
    """Measure, print, store."""
    options = arguments(given)
    if options.read:
        read(options.read, options.seconds, shared=options.shared)
        return 0
    found: Found = {}
    for scale, rate in product(options.scales, options.rates):
        with tempfile.TemporaryDirectory(prefix="latency-", dir=options.dir) as directory:
            found[scale, rate] = measure(options, scale, rate, Path(directory))
    console = Console(width=None if sys.stdout.isatty() else 170)
    for table in tables(found):
        table.print(console)
    results = [
        {"scale": scale, "rate_hz": rate, "load": name, "received_ms": percentiles(one.received_ms),
         "finished_ms": percentiles(one.finished_ms), "received": len(one.received_ms), "pairs": one.pairs,
         "clouds": one.clouds, "seconds": one.seconds, "cpu_ms": {thread: one.cpu_ms(thread) for thread in one.cpu_s},
         "drops": one.drops, "recorded": one.recorded}
        for (scale, rate), pair in found.items() for name, one in zip(LOADS, pair, strict=True)
    ]  # fmt: skip
    write_whole(options.out / "latency.json", json.dumps(results, indent=1) + "\n")
    problems = faults(found)
    print("\n".join(f"NOT GOOD: {problem}" for problem in problems) or "good: P99 within a tenth of that alone")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
