"""Compiles all kernels into the cache on disk, so that the tests' time-outs are those of running them.

Compiling takes minutes on a slow machine, and several processes that tests start would each wait for it or do it again.
A second process compiles at the same time what shares the least with the single shot of three-chip images, with which
the first one begins; what it has done by then, the first one finds.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from daemon.apps.install.kernels import ENCODINGS, compile_all, compile_modes, small_layout, small_pair

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


def compile_ahead() -> None:
    """Compile rendering, and the decoder of mosaics."""
    from pipeline.reconstruct.reconstructor import Reconstructor
    from sim.rig.optics import Optics

    for encoding in ENCODINGS:
        pair = small_pair(encoding)
    layout = small_layout()
    made = Reconstructor(layout.calibration_for(Optics()), layout.pattern(), layout.volume(), encoding=encoding)
    made.decoders[0].decode(pair.left)


def main() -> None:
    """Compile what measuring and rendering need, the modes as far as tests use them."""
    if sys.argv[1:] == ["ahead"]:
        compile_ahead()
        return
    with subprocess.Popen([sys.executable, "-m", "tests.kernels", "ahead"]) as other:
        compile_all()
        compile_modes(
            [("heterodyne", "bayer_rggb8"), ("heterodyne", "mono16"), ("gray", "rgb8"), ("two_color", "rgb8")]
        )
        other.wait()


if __name__ == "__main__":
    main()
