"""While it runs: a device that moves is refuted at once, a refutation lasts, and what can be measured again is."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.calibration.disturbed import images_of, turned
from benchmarks.reconstruction.cases import Case, scaled
from pipeline.common.errors import ImageError
from pipeline.monitor.check import checked_reconstructor
from pipeline.monitor.check.checked_reconstructor import CHANGED, CheckedReconstructor
from pipeline.reconstruct.consistency import ColumnScan, Consistency
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.evaluate.point_errors import point_errors
from sim.render.render_pair import truths
from sim.scene.named_scenes import build

CASE = scaled(Case("running", "mixed"), 0.5)
PAIRS = 8


@functools.cache
def images(device: str = "", axis: int = 0, degrees: float = 0.0):
    changes = [turned(device, axis, degrees)] if device else []
    pair = images_of(CASE, *changes)
    for image in pair:
        image.setflags(write=False)
    return pair


def running(policy: str = "withhold") -> CheckedReconstructor:
    """A reconstructor that has seen a good pair."""
    made = fresh(policy)
    assert made.reconstruct(*images()).consistency.verdict == "consistent"
    return made


def fresh(policy: str = "withhold") -> CheckedReconstructor:
    inner = Reconstructor(CASE.layout.calibration_for(CASE.optics), CASE.pattern, CASE.layout.volume())
    return CheckedReconstructor(inner, policy)


@pytest.mark.parametrize(
    ("device", "axis", "degrees"),
    [("right", 0, 1.0), pytest.param("right", 1, 0.1, marks=pytest.mark.long), ("projector", 1, 0.05)],
)
def test_a_device_that_turns_while_it_runs_is_refuted_with_the_next_pair(device: str, axis: int, degrees: float):
    made = running()
    for _ in range(PAIRS + 1):
        cloud = made.reconstruct(*images(device, axis, degrees))
        assert cloud.consistency.verdict == "inconsistent"
        assert cloud.points == 0
        assert cloud.consistency.findings and cloud.consistency.cause


@pytest.mark.parametrize("wrong", [(0, 0), pytest.param((1, 1), marks=pytest.mark.long), (1, 0)])
def test_an_image_of_the_other_camera_is_refuted_with_the_next_pair_and_so_is_its_end(wrong: tuple[int, int]):
    made, good = running(), images()
    before = made.reconstruct(*good).xyz
    for _ in range(3):
        assert made.reconstruct(good[wrong[0]], good[wrong[1]]).points == 0
    verdicts = [made.reconstruct(*good).consistency.verdict for _ in range(PAIRS + 1)]
    assert verdicts[0] == "inconsistent" and verdicts[-1] == "consistent"
    np.testing.assert_array_equal(made.reconstruct(*good).xyz, before)


@pytest.mark.parametrize(
    ("device", "degrees", "last"),
    [("projector", 0.008, "consistent"), ("right", 0.05, "inconsistent")],
    ids=["by a projector's drift", "by a turn of the right camera"],
)
def test_columns_that_have_moved_are_measured_again_and_kept_if_that_is_a_drift(device: str, degrees: float, last: str):
    """With the columns of the first pair points are lost, and most of the second one's are wrong."""
    made, moved = running("warn"), images(device, 1, degrees)
    truth, _ = truths(CASE.layout, build(CASE.scene))
    volume = CASE.layout.volume()
    first = made.reconstruct(*moved)
    assert first.consistency.verdict == "inconsistent"
    for _ in range(2 * PAIRS + 2):
        cloud = made.reconstruct(*moved)
        wrong = point_errors(cloud.xyz, cloud.sigma_mm, truth, (volume.near_mm, volume.far_mm)).wrong
        assert cloud.consistency.verdict == "inconsistent" or (wrong < 0.002 and cloud.points > first.points)
    assert cloud.consistency.verdict == last
    assert (wrong > 0.9) == (last == "inconsistent")


def test_a_projector_that_drifts_slowly_is_followed():
    """By steps of a quarter of a column: of ten pairs each no more than three are lost."""
    made = running()
    for degrees in (0.0036, 0.0072):
        moved = images("projector", 1, degrees)
        points = [made.reconstruct(*moved).points for _ in range(10)]
        assert sum(count == 0 for count in points) <= 3, (degrees, points)
        assert points[-1] > 100_000
    assert made.reconstruct(*moved).consistency.readings["column_offset"].value == pytest.approx(0.0072, abs=0.001)


@pytest.mark.parametrize("before", [1.0, 0.5])
def test_a_camera_of_another_brightness_is_followed(before: float):
    """A right image of half the counts: without the correction a pair with all its points is refuted."""
    good = images()
    half = good[0], (good[1] // 2).astype(np.uint8)
    first, then = (good, half) if before == 1 else (half, good)
    made = fresh()
    assert made.reconstruct(*first).points > 100_000
    assert float(made.inner.response[4]) == pytest.approx(before, rel=0.1)
    last = [made.reconstruct(*then) for _ in range(4)][-1]
    assert last.consistency.verdict == "consistent" and last.points > 100_000
    assert float(made.inner.response[4]) == pytest.approx(1.5 - before, rel=0.1)


def test_a_first_pair_that_shows_nothing_useful_is_replaced():
    made, good = fresh(), images()
    assert made.reconstruct(good[0], good[0]).points == 0
    last = [made.reconstruct(*good) for _ in range(2 * PAIRS + 1)][-1]
    assert last.consistency.verdict == "consistent"
    np.testing.assert_array_equal(last.xyz, running().reconstruct(*good).xyz)


def test_an_image_of_another_size_costs_no_state():
    made, good = fresh(), images()
    assert made.reconstruct(good[0], good[0]).points == 0
    before = made.inner.state()
    for _ in range(PAIRS - 1):
        made.reconstruct(*good)
    with pytest.raises(ImageError, match="left image is"):  # of a pair that is measured like a first one
        made.reconstruct(good[0][:-1], good[1])
    assert made.inner.state()[1] is before[1] is True
    last = [made.reconstruct(*good) for _ in range(PAIRS + 2)][-1]
    assert last.consistency.verdict == "consistent"


def test_the_check_does_not_change_clouds_that_expect_the_orders_of_the_pair_before():
    checked, plain = running(), fresh("off")
    plain.reconstruct(*images())
    for _ in range(3):
        clouds = [made.reconstruct(*images(), use_prior=True) for made in (checked, plain)]
        np.testing.assert_array_equal(clouds[0].xyz, clouds[1].xyz)


class Answers:
    """A reconstructor's inside whose costs and verdicts are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cost, self.verdict, self.scans = 0.0, "consistent", 0
        self.scan = self._new()
        monkeypatch.setattr(CheckedReconstructor, "new_check", lambda _: SimpleNamespace(check=self._check))

    def _check(self, *_) -> Consistency:
        return Consistency(self.verdict, findings=("found",) if self.verdict == "inconsistent" else ())

    def _new(self) -> ColumnScan:
        return ColumnScan(0.0, 0.0, 0.0, 0.0, 0.0, used_relative=self.cost, unrelated=1.0)

    def state(self) -> None:
        """None is needed here."""

    def brightness_has_changed(self) -> bool:
        return False

    def current_cost(self) -> float:
        return self.cost

    def scan_columns(self) -> ColumnScan:
        self.scans += 1
        return self._new()


def judged(made: CheckedReconstructor) -> Consistency:
    image = np.zeros((2, 2), np.uint8)
    return made._verdict(image, image, None)


def test_a_pair_is_scanned_where_its_cost_is_another_and_not_otherwise(monkeypatch: pytest.MonkeyPatch):
    inside = Answers(monkeypatch)
    made = CheckedReconstructor(inside)
    for cost, scans in ((0.0, 0), (0.0, 0), (0.9 * CHANGED, 0), (1.1 * CHANGED, 1), (1.2 * CHANGED, 1), (0.0, 2)):
        inside.cost = cost
        judged(made)
        assert inside.scans == scans, cost


def test_scenes_that_alternate_are_scanned_in_every_eighth_pair_after_the_first_few(monkeypatch: pytest.MonkeyPatch):
    inside = Answers(monkeypatch)
    made = CheckedReconstructor(inside)
    judged(made)
    for n in range(80):
        inside.cost = float(n % 2)
        judged(made)
    assert 80 // PAIRS <= inside.scans <= 80 // PAIRS + 5


@pytest.mark.parametrize("verdict", ["doubtful", "inconsistent"])
def test_pairs_that_are_not_consistent_are_scanned_in_every_eighth(monkeypatch: pytest.MonkeyPatch, verdict: str):
    inside = Answers(monkeypatch)
    made = CheckedReconstructor(inside)
    judged(made)
    inside.verdict = verdict
    for _ in range(40):
        judged(made)
    assert inside.scans == 40 // PAIRS


def test_a_refutation_counts_for_eight_pairs_and_its_finding_is_named(monkeypatch: pytest.MonkeyPatch):
    inside = Answers(monkeypatch)
    made = CheckedReconstructor(inside)
    after = functools.partial(made._after_refutations, confirmed=False)
    assert after(Consistency("consistent")).verdict == "consistent"
    refuted = Consistency("inconsistent", findings=("epipolar +1",), cause="a camera is turned")
    assert after(refuted) is refuted
    for n in range(1, PAIRS + 1):
        held = after(Consistency("consistent"))
        assert (held.verdict, held.cause) == ("inconsistent", refuted.cause)
        assert held.findings == (f"{n} pairs before: epipolar +1",)
    assert after(Consistency("consistent")).verdict == "consistent"
    after(refuted)
    assert made._after_refutations(Consistency("consistent"), confirmed=True).verdict == "consistent"
    assert checked_reconstructor._PAIRS == PAIRS
