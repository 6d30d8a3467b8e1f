"""Compiles all kernels into the cache on disk, so that the tests' time-outs are those of running them.

Compiling takes minutes on a slow machine, and several processes that tests start would each wait for it or do it again.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from daemon.install.kernels import compile_all, compile_modes

TIMEOUT_S = 1500


def compile_elsewhere() -> str:
    """Compile in a process of its own, or find all compiled; returns what went wrong, or nothing."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "tests.kernels"], cwd=Path(__file__).parents[1], capture_output=True, text=True,
            timeout=TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"the kernels are not compiled after {TIMEOUT_S} s"
    return done.stderr if done.returncode else ""


def main() -> None:
    """Compile what measuring and rendering need, the modes as far as tests use them."""
    compile_all()
    compile_modes([("heterodyne", "bayer_rggb8"), ("heterodyne", "mono16"), ("gray", "rgb8"), ("two_color", "rgb8")])


if __name__ == "__main__":
    main()
