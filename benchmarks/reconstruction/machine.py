"""Description of the machine, and the speed of its memory."""

from __future__ import annotations

import os
import platform
import re
import statistics
import subprocess
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from benchmarks.common.tables import Table

_COPIED_MIB = 128


def describe() -> dict[str, str]:
    """Names and versions, the load before the benchmark, and the time of the measurement."""
    names = re.findall(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text())
    return {
        "measured": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _commit(),
        "processor": names[0] if names else platform.machine(),
        "cores": str(os.cpu_count()),
        "load before": f"{os.getloadavg()[0]:.2f}",
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba")},
        "memory copy": f"{copy_gb_per_s():.1f} GB/s read and written by one thread",
    }


def copy_gb_per_s(repeats: int = 9) -> float:
    """Bytes read plus bytes written a second when one thread copies more than any cache holds."""
    source = np.ones(_COPIED_MIB << 17)
    target = np.zeros_like(source)
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - start)
    return 2 * source.nbytes / statistics.median(seconds) / 1e9


def table(machine: dict[str, str]) -> Table:
    """The same as a table."""
    found = Table("machine", "Measured on", ["what", "value"], text_columns=("value",))
    for name, value in machine.items():
        found.add(name, value)
    return found


def _commit() -> str:
    root = Path(__file__).resolve().parents[2]
    try:
        result = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=root, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return result.stdout.strip()
