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
    rehearse()
    compile_modes()


def compile_modes() -> None:
    """Compile what measuring with sets of pictures needs."""
    from pipeline.modes.reconstruct import SetReconstructor
    from pipeline.modes.sequences import mode_sequence
    from sim.optics import Optics
    from sim.rig import RigLayout

    layout = RigLayout().scaled(0.125)
    calibration = layout.calibration_for(Optics())
    for mode, encoding in (
        ("heterodyne", "bayer_rggb8"), ("heterodyne", "mono16"), ("gray", "rgb8"), ("two_color", "rgb8"),
    ):  # fmt: skip
        sequence = mode_sequence(mode, layout.projector_size, periods=layout.periods)
        SetReconstructor(calibration, sequence, layout.volume(), encoding=encoding).warm_up()


if __name__ == "__main__":
    main()
