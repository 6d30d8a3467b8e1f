"""Compiles all kernels into the cache on disk, so that the tests' time-outs are those of running them.

Compiling takes minutes on a slow machine, and several processes that tests start would each wait for it or do it again.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TIMEOUT_S = 1500
ENCODINGS = "rgb8", "bayer_rggb8"


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
    """Compile what measuring and rendering need."""
    from pipeline.drift.observe import rehearse
    from pipeline.modes.reconstruct import SetReconstructor
    from pipeline.modes.sequences import MODES, mode_sequence
    from pipeline.reconstruct import Reconstructor
    from sim.optics import Optics
    from sim.render import render_pair
    from sim.rig import RigLayout
    from sim.scenes import build

    layout, optics = RigLayout().scaled(0.125), Optics()
    pattern = layout.pattern()
    for encoding in ENCODINGS:
        made = Reconstructor(layout.calibration_for(optics), pattern, layout.volume(), encoding=encoding)
        made.warm_up(every=(1, 2), follow=True)
        pair = render_pair(layout, build("moving"), pattern, optics, encoding=encoding)
        made.reconstruct(pair.left, pair.right)
    for mode in MODES:
        sequence = mode_sequence(mode, pattern.size, periods=pattern.periods)
        SetReconstructor(layout.calibration_for(optics), sequence, layout.volume()).warm_up()
    rehearse()


if __name__ == "__main__":
    main()
