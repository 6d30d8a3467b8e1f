"""The calibration check on disturbed and on intact rigs: ``python -m benchmarks.calibration.disturbed --clean 500``.

The images come from rigs whose devices stand otherwise than the calibration has them: turned, exchanged, with another
focal length. Each row compares what a daemon without the check would publish with what it publishes, of a first pair
and of three pairs after one of the intact rig, as if the device had moved in the meantime. Intact rigs with the hard
scenes, Bayer mosaics and an uncalibrated projector response show how often the check is wrong; ``--rigs`` turns the
devices of rigs of random design instead. The exit code is 1 if wrong points are published or an intact rig is withheld.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Any

from numpy.typing import NDArray
from rich.console import Console

from benchmarks.common.arguments import positive
from benchmarks.common.tables import Table
from benchmarks.reconstruction.cases import HARD, Case, scaled
from benchmarks.reconstruction.random_rigs import random_rig
from pipeline.monitor.check.checked_reconstructor import CheckedReconstructor
from pipeline.reconstruct.consistency import Consistency
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from sim.evaluate.point_errors import PointErrors, point_errors
from sim.render.render_pair import render_counts, truths, with_noise
from sim.rig.disturbance import Device, Disturbance, TrueRig
from sim.scene.named_scenes import build

ANGLES_DEG = (0.05, 0.1, 0.3, 1.0)
INTACT = "none"
AXES = ("pitch", "yaw", "roll")
LARGEST_WRONG = 0.001
"""Share of points that err by over 6 mm in a published cloud, beyond that of the intact rig."""
_WRONG_OF_DESIGNS = 0.01
_NOISES, _PAIRS_RUNNING = 7, 3
_TURNS: tuple[tuple[Device, int, float], ...] = (
    ("right", 0, 0.1), ("right", 1, 0.1), ("right", 1, 0.3), ("right", 2, 0.3), ("projector", 0, 1.0),
    ("projector", 1, 0.3),
)  # fmt: skip
"""Device, axis and angle by which rigs of random design are disturbed."""

Pair = tuple[NDArray[Any], NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a pair gives: errors and number of its points, and the verdict on it."""

    errors: PointErrors
    points: int
    found: Consistency

    @property
    def published(self) -> int:
        """Points that a daemon with the default policy publishes."""
        return 0 if self.found.verdict == "inconsistent" else self.points


def answer(case: Case, images: Pair, calibration: Calibration | None = None) -> Answer:
    """Reconstruct a first pair; errors against the truth of the rig as calibrated."""
    return _answers(case, _reconstructor(case, calibration), images, 1)[0]


def running(case: Case, intact: Pair, images: Pair) -> Answer:
    """Reconstruct pairs after one of the intact rig; the first of them that is published, or the first."""
    made = _reconstructor(case)
    made.reconstruct(*intact)
    found = _answers(case, made, images, _PAIRS_RUNNING)
    return next((one for one in found if one.published), found[0])


def _reconstructor(case: Case, calibration: Calibration | None = None) -> CheckedReconstructor:
    calibration = calibration or case.layout.calibration_for(case.optics)
    inner = Reconstructor(calibration, case.pattern, case.layout.volume(), encoding=case.encoding)
    return CheckedReconstructor(inner, "warn")


def _answers(case: Case, made: CheckedReconstructor, images: Pair, count: int) -> list[Answer]:
    truth, _ = truths(case.layout, build(case.scene))
    volume = case.layout.volume()
    out = []
    for _ in range(count):
        cloud = made.reconstruct(*images)
        assert cloud.consistency is not None
        errors = point_errors(cloud.xyz, cloud.sigma_mm, truth, (volume.near_mm, volume.far_mm))
        out.append(Answer(errors, cloud.points, cloud.consistency))
    return out


def images_of(case: Case, *changes: Disturbance, seed: int = 0) -> Pair:
    """The images of a case, taken by a rig that was disturbed after its calibration."""
    rig = TrueRig.of(case.layout, case.optics)
    for change in changes:
        rig = rig.after(change)
    counts = render_counts(
        case.layout, build(case.scene), case.pattern, case.optics, encoding=case.encoding, rig=rig
    )  # fmt: skip
    return with_noise(counts, case.optics, seed, case.encoding)


def turned(device: Device, axis: int, degrees: float) -> Disturbance:
    """A turn about one axis of the device's frame, 0 = horizontal, 1 = vertical, 2 = optical."""
    x, y, z = (degrees * (axis == k) for k in range(3))
    return Disturbance(device, turn_deg=(x, y, z))


def answers(case: Case) -> Iterator[tuple[str, Answer, Answer | None]]:
    """Every disturbance by name, with what it gives as a first pair and, where that can happen, while the rig runs."""
    intact = images_of(case)
    yield INTACT, answer(case, intact), running(case, intact, intact)
    devices: tuple[tuple[Device, str], ...] = (
        ("right", "right camera"), ("left", "left camera"), ("projector", "projector"),
    )  # fmt: skip
    for device, name in devices:
        for k, axis in enumerate(AXES):
            for angle in ANGLES_DEG:
                images = images_of(case, turned(device, k, angle))
                yield f"{name}, {axis} {angle:g} deg", answer(case, images), running(case, intact, images)
    for name, images in (("cameras exchanged", intact[::-1]), ("left image as both", (intact[0], intact[0]))):
        yield name, answer(case, images), running(case, intact, images)
    calibration = case.layout.calibration_for(case.optics)
    for device, name in devices:
        matrix = getattr(calibration, device).matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1.005
        changed = replace(calibration, **{device: replace(getattr(calibration, device), matrix=matrix)})
        yield f"{name}, focal length 0.5 % too large", answer(case, intact, changed), None


def disturbed(case: Case) -> tuple[Table, list[str]]:
    """The table of all disturbances, and those with which wrong points are published."""
    table = Table(
        "disturbed", f"Disturbed after the calibration, {case.scene}",
        ["disturbance", "points unchecked", "wrong %", "rms um", "verdict", "published", "running: wrong %", "verdict",
         "published", "cause"],
        text_columns=("verdict", "cause"),
    )  # fmt: skip
    wrong, intact = [], 0.0
    for name, first, later in answers(case):
        after = (f"{100 * later.errors.wrong:.2f}", later.found.verdict, f"{later.published:,}") if later else ("",) * 3
        table.add(
            name, f"{first.points:,}", f"{100 * first.errors.wrong:.2f}", f"{1e3 * first.errors.rms_mm:.0f}",
            first.found.verdict, f"{first.published:,}", *after,
            first.found.cause or "; ".join(first.found.findings[:1]),
        )  # fmt: skip
        intact = first.errors.wrong if name == INTACT else intact
        for found, when in ((first, ""), (later, "while it runs, ")):
            if found and found.published and not found.errors.wrong <= intact + LARGEST_WRONG:
                share = f"{100 * found.errors.wrong:.2f} % of {found.published:,}"
                wrong.append(f"{when}{name}: {share} published points are wrong")
    return table, wrong


def designs(cases: Sequence[Case]) -> tuple[Table, list[str]]:
    """The table of turned devices of rigs of other designs, and the rigs that publish wrong points because of it."""
    table = Table(
        "designs", f"{len(cases)} rigs of random design, disturbed after the calibration",
        ["disturbance", "rigs with wrong points", "published", "withheld", "running: wrong points", "published",
         "withheld"],
    )  # fmt: skip
    intact = [images_of(case) for case in cases]
    before = [answer(case, images) for case, images in zip(cases, intact, strict=True)]
    false_alarms = sum(found.found.verdict == "inconsistent" for found in before)
    table.add(INTACT, "", str(len(cases) - false_alarms), str(false_alarms), "", "", "")
    wrong = []
    for device, axis, angle in _TURNS:
        name, counts = f"{device}, {AXES[axis]} {angle:g} deg", [0, 0, 0, 0]
        for case, untouched, usual in zip(cases, intact, before, strict=True):
            images = images_of(case, turned(device, axis, angle))
            for when, found in enumerate((answer(case, images), running(case, untouched, images))):
                if found.points and found.errors.wrong > usual.errors.wrong + _WRONG_OF_DESIGNS:
                    counts[2 * when + (found.published == 0)] += 1
                    if found.published:
                        share = f"{100 * found.errors.wrong:.1f} % of {found.published:,} wrong"
                        wrong.append(f"{case.name}, {name}{', while it runs' * when}: {share}")
        table.add(name, str(sum(counts[:2])), *map(str, counts[:2]), str(sum(counts[2:])), *map(str, counts[2:]))
    table.notes.append(
        f"Wrong: {100 * _WRONG_OF_DESIGNS:g} % of the points more than with the intact rig err by over 6 mm."
    )
    return table, wrong


def clean(cases: list[Case], pairs: int) -> tuple[Table, list[str]]:
    """Verdicts on pairs of intact rigs, each with noise of its own: as first pairs, and one after the other."""
    shown = ("consistent", "doubtful", "inconsistent", "unknown")
    table = Table("false_alarms", f"Intact rigs, {pairs} pairs, each as a first one and after the others of its case",
                  ["case", "pairs", *shown, *(f"running: {one}" for one in shown)])  # fmt: skip
    runs = {case.name: _reconstructor(case) for case in cases}
    verdicts = {case.name: (Counter[str](), Counter[str]()) for case in cases}
    alarms = []
    for case, images in islice(_clean_pairs(cases), pairs):
        for made, counted in zip((_reconstructor(case), runs[case.name]), verdicts[case.name], strict=True):
            found = made.reconstruct(*images).consistency
            assert found is not None
            counted[found.verdict] += 1
            if found.verdict == "inconsistent":
                alarms.append(f"{case.name}: withheld: {found.reason}")
    for name, both in verdicts.items():
        table.add(name, str(both[0].total()), *(str(counted[one]) for counted in both for one in shown))
    return table, alarms


def _clean_pairs(cases: list[Case]) -> Iterator[tuple[Case, Pair]]:
    """Pairs of all cases in turn, endlessly: textures of a new seed in every round, several noises of each."""
    for number, case in enumerate(cycle(cases)):
        seed = number // len(cases)
        scene = build(case.scene, seed=seed)
        counts = render_counts(case.layout, scene, case.pattern, case.optics, encoding=case.encoding)
        for noise in range(_NOISES):
            yield case, with_noise(counts, case.optics, _NOISES * number + noise, case.encoding)


def main(given: list[str]) -> int:
    """Print both tables and what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="of images and fringes, 1 = 1024 x 820")
    parser.add_argument("--scene", default="mixed", help="of the disturbed rigs")
    parser.add_argument("--clean", type=positive, default=0, help="pairs of intact rigs")
    parser.add_argument("--rigs", type=positive, default=0, help="disturb as many rigs of random design instead")
    parser.add_argument("--intact-only", action="store_true", help="the intact rigs only")
    options = parser.parse_args(given)
    console = Console(width=None if sys.stdout.isatty() else 200)
    problems: list[str] = []
    if options.rigs:
        table, problems = designs([scaled(random_rig(number), options.scale) for number in range(options.rigs)])
        table.print(console)
    elif not options.intact_only:
        table, problems = disturbed(scaled(Case("disturbed", options.scene), options.scale))
        table.print(console)
    if options.clean:
        table, alarms = clean([scaled(case, options.scale) for case in HARD], options.clean)
        table.print(console)
        problems += alarms
    for problem in problems:
        console.print(f"MISSED {problem}", highlight=False)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
