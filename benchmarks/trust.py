"""Wrong points, false surfaces and error against sigma on hard cases; ``python -m benchmarks.trust --scale 0.5``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.accuracy import ceiling
from benchmarks.common.arguments import positive
from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import HARD, Case, random_case, scaled
from benchmarks.reconstruction.random_rigs import random_rig
from sim.evaluate.point_errors import RINGS, PointErrors, Ring, point_errors

_RINGS = tuple(name for name, _, _ in RINGS)
_LIMITS = {
    "standard": (0.985, 0.0005),
    "over-exposed 1.8 times": (0.97, 0.001),
    "projector in the middle": (0.975, 0.001),
    "Bayer, realistic": (0.975, 0.001),
}
_OTHER_LIMITS = (0.0, 0.001)
_SIGMA_RANGE, _RING_SIGMA = (0.8, 1.3), 1.5


def by_case(cases: Sequence[Case], seeds: int) -> tuple[list[Table], dict[str, Any], list[tuple[str, bool]]]:
    """Tables of points and of sigma, plain figures by case, and the limits with whether each is kept."""
    points = Table(
        "trust",
        f"Points that can be trusted, {seeds} seed{'s' * (seeds != 1)}",
        ["case", "within 1 mm %", *(f"{name} %" for name in _RINGS), "wrong %", "alone %", "false surfaces", "rms um"],
    )
    sigmas = Table("sigma", "Error / sigma, rms", ["case", "all", *_RINGS, *(f"wrong {name} %" for name in _RINGS)])
    figures: dict[str, Any] = {}
    promises = []
    for case in cases:
        found = _mean([errors_of(case, seed) for seed in range(seeds)])
        figures[case.name] = asdict(found)
        rings = [found.rings[name] for name in _RINGS]
        points.add(
            case.name, f"{100 * found.covered:.2f}", *(f"{100 * ring.covered:.1f}" for ring in rings),
            f"{100 * found.wrong:.3f}", f"{100 * found.wrong_alone:.3f}",
            f"{found.false_surfaces} of {found.false_points}", f"{1e3 * found.rms_mm:.0f}",
        )  # fmt: skip
        ratios = [ring.error_to_sigma for ring in rings]
        sigmas.add(
            case.name, f"{found.error_to_sigma:.2f}", *(f"{ratio:.2f}" for ratio in ratios),
            *(f"{100 * ring.wrong:.3f}" for ring in rings),
        )  # fmt: skip
        least, most = _LIMITS.get(case.name, _OTHER_LIMITS)
        promises += [
            (f"{case.name}: no false surface", found.false_surfaces == 0),
            (f"{case.name}: within 1 mm {100 * least:.1f} %", found.covered >= least),
            (f"{case.name}: wrong {100 * most:.2f} %", found.wrong <= most),
            (f"{case.name}: error / sigma 0.8 to 1.3", _SIGMA_RANGE[0] <= found.error_to_sigma <= _SIGMA_RANGE[1]),
            (f"{case.name}: error / sigma at most 1.5 in each ring", max(ratios) <= _RING_SIGMA),
        ]
    rings_text = ", ".join(f"{name} from {least:g} px" for name, least, _ in RINGS)
    points.notes.append(f"Distance to an edge or to the end of what is measurable: {rings_text}. Wrong: by over 6 mm.")
    return [points, sigmas], figures, promises


def errors_of(case: Case, seed: int) -> PointErrors:
    """Errors of one pair of a case, rendered or from disk."""
    pair = rendered.stored_pair(case, seed)
    cloud = case.reconstructor().reconstruct(pair.left, pair.right)
    volume = case.layout.volume()
    return point_errors(cloud.xyz, cloud.sigma_mm, pair.truth_left, (volume.near_mm, volume.far_mm))


def _mean(found: Sequence[PointErrors]) -> PointErrors:
    """Means over the seeds; false surfaces are summed."""
    rings = {
        name: Ring(*(float(np.mean([getattr(one.rings[name], key) for one in found])) for key in Ring.__slots__))
        for name in _RINGS
    }
    means = {
        key: float(np.mean([getattr(one, key) for one in found]))
        for key in ("covered", "wrong", "wrong_alone", "rms_mm", "error_to_sigma")
    }
    surfaces, points = sum(one.false_surfaces for one in found), sum(one.false_points for one in found)
    return PointErrors(false_surfaces=surfaces, false_points=points, rings=rings, **means)


def main(given: list[str]) -> int:
    """Print the tables and the limits that are missed; exit code 1 if one is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="of images and fringes, 1 = 1024 x 820")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--case", default="", help="those whose name contains this")
    parser.add_argument("--random", type=positive, default=0, help="as many random scenes and rigs instead")
    parser.add_argument("--rigs", type=positive, default=0, help="as many rigs of random design instead")
    parser.add_argument("--ceiling", action="store_true", help="coverage with true fringe orders and without filters")
    options = parser.parse_args(given)
    drawn = [random_case(number) for number in range(options.random)]
    drawn += [random_rig(number) for number in range(options.rigs)]
    every = drawn or HARD
    cases = [scaled(case, options.scale) for case in every if options.case in case.name]
    if not cases:
        parser.error(f"--case {options.case!r}: no name contains this; there are {', '.join(c.name for c in every)}")
    console = Console(width=None if sys.stdout.isatty() else 170)
    if options.ceiling:
        ceiling.table_of(cases, options.seeds).print(console)
        return 0
    tables, _, promises = by_case(cases, options.seeds)
    for table in tables:
        table.print(console)
    for what in (what for what, kept in promises if not kept):
        console.print(f"MISSED {what}", highlight=False)
    return 0 if all(kept for _, kept in promises) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
