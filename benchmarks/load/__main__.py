"""The measurement under load against the same without: ``make load``.

A daemon measures a simulated rig whose images are played; rounds without and with all clients alternate, so that a
change of the machine's speed affects both. All: 4 subscribers of whole clouds, 4 of light ones, 20 that ask for
the status once a second, one that is stopped (SIGSTOP), one that never reads. They run at idle priority on the same
processors, as on a rig PC they would run elsewhere. The exit code is 1 when the rate or the P99 latency (start of
exposure to cloud, as the daemon states it) differs by more than a tenth.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.common.daemon_process import DaemonProcess
from benchmarks.load.clients import LoadClients
from daemon.common.files import write_atomically
from fringed import wire
from fringed.stream.receiver import Receiver

ALL = {"full": 4, "light": 4, "poller": 20, "stopped": 1, "silent": 1}
_TOLERANCE = 0.1


class Round:
    """Clouds of some seconds in the light stream, read by one more client in both kinds of round."""

    def __init__(self, endpoint: str, seconds: float) -> None:
        self.latencies_ms: list[float] = []
        receiver = Receiver(endpoint, ["cloud/depth"], queue=64)
        try:
            receiver.poll(30.0)
            receiver.take()
            started_s = time.monotonic()
            while time.monotonic() - started_s < seconds:
                if receiver.poll(0.1) and (frames := receiver.take()) is not None:
                    header = wire.decode_header(frames)[1]
                    assert isinstance(header, wire.CloudHeader)
                    self.latencies_ms.append(header.stats["latency_ms"])
            self.rate_hz = len(self.latencies_ms) / (time.monotonic() - started_s)
        finally:
            receiver.close()


def percentile(values: list[float], share: float) -> float:
    """The value below which this share lies."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def rig_of(options: argparse.Namespace, directory: Path) -> dict[str, Any]:
    """The content of rig.yaml."""
    layout = {} if options.scale == 1 else {"layout": {"scale": options.scale}}
    return {
        "cameras": {"driver": "sim"},
        "simulation": {"scene": "moving", "frames": 12, "rate_hz": options.rate, **layout},
        "stream": {"endpoints": [f"ipc://{directory}/stream"]},
        "control": {"endpoint": f"ipc://{directory}/control"},
    }


def measure(options: argparse.Namespace, directory: Path) -> dict[str, Any]:
    """Rounds in turn; medians over the rounds and their ratios."""
    rig, path = rig_of(options, directory), directory / "rig.yaml"
    path.write_text(json.dumps(rig), encoding="utf-8")
    stream, control = rig["stream"]["endpoints"][0], rig["control"]["endpoint"]
    alone: list[Round] = []
    loaded: list[Round] = []
    with DaemonProcess(path, control, directory / "log") as daemon:
        daemon.until(lambda status: status["clouds"] > 20, 600.0, "clouds")
        for _ in range(options.rounds):
            alone.append(Round(stream, options.seconds))
            with LoadClients(stream, control, ALL):
                before = _sent(daemon)
                loaded.append(Round(stream, options.seconds))
                after = _sent(daemon)
            print(f"alone {_line(alone[-1])}; loaded {_line(loaded[-1])}", flush=True)
        status = daemon.ask("status")
    return {
        "options": {"scale": options.scale, "rate_hz": options.rate, "rounds": options.rounds},
        "alone": _figures(alone),
        "loaded": _figures(loaded),
        "messages_sent_in_last_round": {topic: after[topic] - before.get(topic, 0) for topic in after},
        "drops": status["drops"],
    }


def _sent(daemon: DaemonProcess) -> dict[str, int]:
    return dict(daemon.ask("status", timeout_s=30.0)["sinks"]["stream"]["sent"])


def _figures(rounds: list[Round]) -> dict[str, float]:
    return {
        "rate_hz": median(one.rate_hz for one in rounds),
        "p50_ms": median(percentile(one.latencies_ms, 0.5) for one in rounds),
        "p99_ms": median(percentile(one.latencies_ms, 0.99) for one in rounds),
    }


def _line(one: Round) -> str:
    p50, p99 = percentile(one.latencies_ms, 0.5), percentile(one.latencies_ms, 0.99)
    return f"{one.rate_hz:.2f}/s, P50 {p50:.1f}, P99 {p99:.1f} ms"


def verdict(result: dict[str, Any]) -> list[str]:
    """Figures that differ by more than a tenth."""
    ratios = {name: result["loaded"][name] / result["alone"][name] for name in ("rate_hz", "p50_ms", "p99_ms")}
    result["ratios"] = ratios
    faults = [] if ratios["rate_hz"] >= 1 - _TOLERANCE else [f"the rate falls to {ratios['rate_hz']:.2f} of it"]
    return faults + ([] if ratios["p99_ms"] <= 1 + _TOLERANCE else [f"the P99 latency is {ratios['p99_ms']:.2f} of it"])


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--scale", type=float, default=0.5, help="size of the images, 1 = 1024 x 820")
    parser.add_argument("--rate", type=float, default=10.0, help="triggers a second")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=15.0, help="of a round")
    parser.add_argument("--out", type=Path, default=Path("out"), help="directory of load.json")
    return parser.parse_args(given)


def main(given: list[str]) -> int:
    """Measure, print, store."""
    options = arguments(given)
    with tempfile.TemporaryDirectory(prefix="load-") as directory:
        result = measure(options, Path(directory))
    problems = verdict(result)
    options.out.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out / "load.json", (json.dumps(result, indent=1) + "\n").encode())
    print(json.dumps(result, indent=1))
    print("\n".join(f"NOT GOOD: {problem}" for problem in problems) or "good: within a tenth of unloaded")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
