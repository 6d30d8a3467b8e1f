"""Start and recovery times of the installed service: ``make bench-service``, as root.

In a container with a real systemd, with a simulated rig at 10 pairs a second (256 x 204 pixels) whose images and
kernels are on disk already, as they are on a rig that was started before:

- start: from ``systemctl start`` until the service is ready, which it is with its first cloud;
- killed: from SIGKILL of the daemon until the service is ready again with another process;
- frozen: the same from SIGSTOP, which the watchdog has to notice.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable

from tests.nspawn.helpers import SERVICE, Fringed, rig
from tools.nspawn import Machine, missing

GOAL_S = 5.0
_SIMULATION = {"scene": "plane", "frames": 4, "rate_hz": 10.0, "layout": {"scale": 0.25}}


def main(arguments: list[str]) -> int:
    """Print the table; 1 when the median time from SIGKILL to the next cloud is above the goal."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.system.service", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--times", type=int, default=5, help="how often each is measured")
    times = parser.parse_args(arguments).times
    if reason := missing():
        sys.stderr.write(f"benchmarks.system.service: {reason}\n")
        return 2
    with Machine() as machine:
        (machine.root / "root/rig.yaml").write_text(rig(simulation=_SIMULATION))
        installed, _ = timed(
            lambda: machine.fringed(
                "install", "--share-packages", "--no-start", "--rig", "/root/rig.yaml", timeout_s=1200
            )
        )
        fringed = Fringed(machine)
        print(f"installed in {installed:.1f} s (kernels that are compiled beside the sources are taken along)")
        fringed.start(rig(simulation=_SIMULATION))  # renders, and warms the page cache
        rows = {
            "start": [start(fringed) for _ in range(times)],
            "killed": [lost(fringed, signal.SIGKILL) for _ in range(times)],
            "frozen": [lost(fringed, signal.SIGSTOP) for _ in range(times)],
        }
        watchdog = machine.show(SERVICE, "WatchdogUSec")["WatchdogUSec"]
    print(f"seconds to the next cloud, {times} times each, watchdog {watchdog}")
    print("| what | median | least | most |\n| --- | --- | --- | --- |")
    for name, found in rows.items():
        print(f"| {name} | {statistics.median(found):.2f} | {min(found):.2f} | {max(found):.2f} |")
    return int(statistics.median(rows["killed"]) > GOAL_S)


def start(fringed: Fringed) -> float:
    """Seconds of one start."""
    fringed.stop()
    return timed(lambda: fringed.machine.systemctl("start", SERVICE, timeout_s=300))[0]


def lost(fringed: Fringed, by: signal.Signals) -> float:
    """Seconds from a signal to the daemon until another one has measured."""
    fringed.wait_clouds()
    pid = fringed.show()["MainPID"]
    outside = fringed.pid_outside(pid)
    began = time.monotonic()
    os.kill(outside, by)
    fringed.wait_active(not_pid=pid)
    return time.monotonic() - began


def timed(action: Callable[[], object]) -> tuple[float, object]:
    """Seconds that it takes, and what it returns."""
    began = time.monotonic()
    done = action()
    return time.monotonic() - began, done


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
