"""A long run under the conditions of a user: ``make soak``.

The daemon measures a moving scene of simulated cameras, whose images are rendered before and only played; a take is
recorded, one subscriber takes whole clouds and one the light ones. At the end: losses by reason, memory, latencies.
The exit code is 1 when a pair was lost or memory grew. Finished parts of the take are removed as they come.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.common.process_statistics import Sample, sample
from benchmarks.soak import report
from benchmarks.soak.readers import Readers
from daemon.common.files import write_atomically
from fringed.control.client import ControlClient
from fringed.errors import ControlError

_TOPICS = ("cloud/full", "cloud/depth")
_FRINGED = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
_PART_MB = 1024
_END_S = 60.0


class Soak:
    """One run; ``options`` as :func:`arguments` gives them."""

    def __init__(self, options: argparse.Namespace, directory: Path) -> None:
        self.options, self.directory = options, directory
        self.control, self.stream = f"ipc://{directory}/control", f"ipc://{directory}/stream"
        self.samples: list[Sample] = []
        self.problems: set[str] = set()

    def rig(self) -> dict[str, Any]:
        """The content of rig.yaml."""
        o = self.options
        layout = {} if o.scale == 1 else {"layout": {"scale": o.scale}}
        return {
            "cameras": {"driver": "sim"},
            "simulation": {"scene": o.scene, "frames": o.frames, "rate_hz": o.rate, **layout},
            "pipeline": {"overload": "skip", "temporal_prior": not o.no_prior, "settings": dict(o.set)},
            "stream": {"endpoints": [self.stream]},
            "control": {"endpoint": self.control},
            "recording": {"dir": str(self.directory / "takes"), "max_part_mb": _PART_MB},
        }

    def run(self) -> dict[str, Any]:
        """Start, soak, stop; the result as plain values."""
        path = self.directory / "rig.yaml"
        path.write_text(json.dumps(self.rig()), encoding="utf-8")  # JSON is YAML
        record = [] if self.options.no_record else ["--record", "soak"]
        command = [sys.executable, "-c", _FRINGED, "run", str(path), *record]
        with (self.directory / "log").open("w") as log:
            process = subprocess.Popen(command, stderr=log)
            readers = Readers(self.stream, _TOPICS)
            try:
                with ControlClient(self.control, timeout_s=5.0) as client:
                    self._until_running(process, client)
                    result = self._soak(process, client, readers)
                process.send_signal(signal.SIGTERM)
                result["exit_status"] = process.wait(_END_S)
            finally:
                readers.close()
                process.kill()
                process.wait()
        return result

    def _until_running(self, process: subprocess.Popen[bytes], client: ControlClient) -> None:
        while process.poll() is None:
            try:
                if client.call("status")["state"] in ("running", "degraded"):
                    return
            except ControlError:
                pass  # it renders its images
            time.sleep(0.2)
        raise SystemExit("the daemon ended while starting:\n" + (self.directory / "log").read_text())

    def _soak(self, process: subprocess.Popen[bytes], client: ControlClient, readers: Readers) -> dict[str, Any]:
        readers.serve(self.options.settle)
        start = self._status(client)
        readers.forget()
        began_s = time.monotonic()
        while (passed_s := time.monotonic() - began_s) < 60 * self.options.minutes:
            readers.serve(1.0)
            self.samples.append(sample(process.pid, passed_s))
            self._prune()
        # Read after the readers' last message, so that the drops include every gap that they counted.
        end = self._status(client)
        seconds = time.monotonic() - began_s
        return self._result(start, end, readers, seconds)

    def _status(self, client: ControlClient) -> dict[str, Any]:
        status: dict[str, Any] = client.call("status")
        self.problems |= set(status["reasons"])
        return status

    def _prune(self) -> None:
        """Remove the finished parts of the take: half an hour is a quarter of a terabyte."""
        for part in (self.directory / "takes").glob("*.mcap"):
            part.unlink()

    def _result(self, start: dict[str, Any], end: dict[str, Any], readers: Readers, seconds: float) -> dict[str, Any]:
        pairs = end["pairs"] - start["pairs"]
        gaps = {r.topic: r.losses.count for r in readers.all}
        latency = {
            "exposure .. cloud": end["latency_ms"],
            "frames here .. cloud published": end["publish_latency_ms"],
        } | {f"exposure .. {r.topic} at the reader": report.percentiles(r.latencies_ms) for r in readers.all}
        memory = report.growth(self.samples) | {"rss_max_mib": max((s.rss_mib for s in self.samples), default=0.0)}
        return {
            "rate_hz": self.options.rate,
            "seconds": round(seconds, 1),
            "pairs": pairs,
            "clouds": end["clouds"] - start["clouds"],
            "points": end["points"],
            "losses": report.losses(start, end, gaps),
            "losses_at_start": start["drops"],
            "received": {r.topic: r.received for r in readers.all},
            "recorded_pairs": end["recorder"].get("pairs", 0) - start["recorder"].get("pairs", 0),
            "recorded_bytes": end["recorder"].get("bytes", 0) - start["recorder"].get("bytes", 0),
            "memory": memory,
            "latency_ms": latency,
            "garbage": end["garbage"],
            "slowest": end["slowest"],
            "page_faults": report.page_faults(start, end, pairs),
            "cpu_ms_per_pair": report.cpu_ms_per_pair(self.samples, pairs),
            "stages_ms": end["stages_ms"],
            "problems": sorted(self.problems),
            "cores": len(os.sched_getaffinity(0)),
            "samples": [
                {"t_s": round(s.t_s, 1), "rss_mib": round(s.rss_mib, 1), "own_mib": round(s.own_mib, 1),
                 "threads": s.threads, "files": s.files}
                for s in self.samples[:: max(1, len(self.samples) // 600)]
            ],
        }  # fmt: skip


def _setting(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    return key, json.loads(value)


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=30.0, help="triggers a second")
    parser.add_argument("--settle", type=float, default=5.0, help="seconds before counting begins")
    parser.add_argument("--scene", default="moving")
    parser.add_argument("--frames", type=int, default=24, help="images in the loop that is played")
    parser.add_argument("--scale", type=float, default=1.0, help="of the images, 1 = 1024 x 820")
    parser.add_argument("--no-record", action="store_true", help="without the recorder")
    parser.add_argument("--no-prior", action="store_true", help="without the temporal prior")
    parser.add_argument("--set", type=_setting, action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--dir", type=Path, help="where the take is written; some GB (default: temporary directory)")
    parser.add_argument("--out", type=Path, default=Path("out"), help="directory of soak.json")
    return parser.parse_args(given)


def main(given: list[str] | None = None) -> int:
    """Run it; 0 = nothing lost, no growth."""
    options = arguments(given)
    with tempfile.TemporaryDirectory(prefix="soak-", dir=options.dir) as directory:
        result = Soak(options, Path(directory)).run()
    faults = report.verdict(result)
    options.out.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out / "soak.json", (json.dumps(result | {"faults": faults}, indent=1) + "\n").encode())
    report.show(result, Console(width=None if sys.stdout.isatty() else 120))
    print("\n".join(f"NOT GOOD: {fault}" for fault in faults) or "good: nothing lost, memory does not grow")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
