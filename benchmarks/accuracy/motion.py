"""Motion during the exposure of a single shot: ``python -m benchmarks.accuracy.motion``, truth at its middle.

Every shape but the largest one moves, each into another direction, by some millimetres while the shutter is open. The
exit code is 1 if a limit of the hard scenes is missed at up to :data:`HELD_MM`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from math import pi

from rich.console import Console

from benchmarks.common.tables import Table
from benchmarks.reconstruction.cases import HARD, Case, scaled
from sim.evaluate.point_errors import PointErrors, point_errors
from sim.render.render_pair import render_counts, truths, with_noise
from sim.scene.named_scenes import build
from sim.scene.scene import Scene
from sim.scene.shapes import Motion

DISTANCES_MM = 0.0, 1.0, 2.0, 4.0, 8.0
HELD_MM, LARGEST_WRONG, LARGEST_RATIO = 2.0, 0.001, 1.3
CASES = "standard", "projector in the middle", "Bayer, realistic", "hand before a face", "slots"
_DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0))


def moving(scene: Scene, distance_mm: float, exposure_s: float) -> Scene:
    """The scene whose shapes pass their places at time 0 at a speed of ``distance_mm`` in an exposure."""
    swing = distance_mm / exposure_s * scene.period_s / (2 * pi)
    rests = max(range(len(scene.shapes)), key=lambda n: scene.shapes[n].radius_mm)
    shapes = [
        shape if n == rests or not distance_mm else
        replace(shape, motion=Motion(swing_mm=tuple(swing * part for part in _DIRECTIONS[n % len(_DIRECTIONS)])))  # type: ignore[arg-type]
        for n, shape in enumerate(scene.shapes)
    ]  # fmt: skip
    return replace(scene, shapes=tuple(shapes))


def measured(case: Case, distance_mm: float) -> PointErrors:
    """Errors of one cloud, whose exposure is centred at time 0."""
    exposure_s, volume = 1e-6 * case.optics.exposure_us, case.layout.volume()
    scene = moving(build(case.scene), distance_mm, exposure_s)
    counts = render_counts(
        case.layout, scene, case.pattern, case.optics, encoding=case.encoding, t_s=-exposure_s / 2
    )  # fmt: skip
    cloud = case.reconstructor().reconstruct(*with_noise(counts, case.optics, 0, case.encoding))
    return point_errors(cloud.xyz, cloud.sigma_mm, truths(case.layout, scene)[0], (volume.near_mm, volume.far_mm))


def main(given: list[str]) -> int:
    """Print the table and the limits that are missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=[case.name for case in HARD], action="append", help="only these cases")
    parser.add_argument("--scale", type=float, default=1.0, help="of images and fringes, 1 = 1024 x 820")
    options = parser.parse_args(given)
    columns = ["case", "mm in the exposure", "within 1 mm %", "wrong %", "false surfaces", "rms um", "error / sigma"]
    table, missed = Table("motion", "Motion during the exposure", columns), []
    for case in (scaled(case, options.scale) for case in HARD if case.name in (options.case or CASES)):
        for distance in DISTANCES_MM:
            found = measured(case, distance)
            table.add(
                case.name, f"{distance:g}", f"{100 * found.covered:.2f}", f"{100 * found.wrong:.3f}",
                f"{found.false_surfaces}", f"{1e3 * found.rms_mm:.0f}", f"{found.error_to_sigma:.2f}",
            )  # fmt: skip
            good = found.wrong <= LARGEST_WRONG and not found.false_surfaces and found.error_to_sigma <= LARGEST_RATIO
            if distance <= HELD_MM and not good:
                missed.append(f"{case.name}, {distance:g} mm")
    console = Console(width=None if sys.stdout.isatty() else 200)
    table.print(console)
    for problem in missed:
        console.print(f"MISSED {problem}", highlight=False)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
