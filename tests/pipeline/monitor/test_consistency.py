"""A rig as calibrated is consistent; a device that has moved is reported and its clouds are withheld."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from benchmarks.reconstruction.cases import HARD, scaled
from pipeline.monitor import observe
from pipeline.monitor.check.checked_reconstructor import CheckedReconstructor
from pipeline.monitor.check.consistency import LIMITS, judged, together
from pipeline.monitor.check.limits import combined
from pipeline.monitor.observe import Observer
from pipeline.reconstruct.consistency import NOISE_COST, ColumnScan, Reading
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from sim.render.render_pair import RenderedPair, render_counts, with_noise
from sim.rig.disturbance import Disturbance, TrueRig
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from sim.scene.shapes import rotation_about
from tests.renders import render_pair

LAYOUT = RigLayout().scaled(0.5)
STANDARD = Optics()
YAW, PITCH, ROLL = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@functools.cache
def pair(scene: str, optics: Optics = STANDARD, encoding: str = "rgb8") -> RenderedPair:
    rendered = render_pair(LAYOUT, build(scene), LAYOUT.pattern(), optics, 0.0, 5, encoding)
    for image in (rendered.left, rendered.right):
        image.setflags(write=False)
    return rendered


def turned(calibration: Calibration, side: str, axis: tuple[float, float, float], degrees: float) -> Calibration:
    """The calibration of a rig whose device has turned since: as if the device stood where the file has it."""
    device: CameraModel = getattr(calibration, side)
    turn = rotation_about(tuple(np.sign(degrees) * np.array(axis)), np.radians(abs(degrees)))
    rotation = turn @ device.rotation
    return replace(calibration, **{side: replace(device, rotation=rotation, translation=-rotation @ device.centre)})


def images_of_turned_left(layout: RigLayout, scene: str, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Of a rig whose left camera has turned about its vertical axis: the calibration's axes are the left camera's."""
    rig = TrueRig.of(layout, STANDARD).after(Disturbance("left", turn_deg=(0.0, degrees, 0.0)))
    counts = render_counts(layout, build(scene), layout.pattern(), STANDARD, rig=rig)
    return with_noise(counts, STANDARD, 5, "rgb8")


def reconstructor(calibration: Calibration | None = None, policy: str = "withhold", **options) -> CheckedReconstructor:
    calibration = calibration or LAYOUT.calibration_for(STANDARD)
    return CheckedReconstructor(Reconstructor(calibration, LAYOUT.pattern(), LAYOUT.volume(), **options), policy)


@pytest.mark.parametrize(
    "scene",
    ["mixed", "steep", *(pytest.param(name, marks=pytest.mark.long) for name in ("face", "gloss", "hand", "isolated"))],
)
def test_a_rig_as_calibrated_is_consistent(scene: str):
    images = pair(scene)
    cloud = reconstructor().reconstruct(images.left, images.right)
    assert cloud.consistency.verdict == "consistent", cloud.consistency.reason
    assert cloud.points > 20_000


def test_every_reading_fits_into_a_message():
    images = pair("mixed")
    calibration = turned(LAYOUT.calibration_for(STANDARD), "right", ROLL, 0.3)
    verdict = reconstructor(calibration).reconstruct(images.left, images.right).consistency
    assert "right_roll" in verdict.readings
    assert msgspec.json.decode(msgspec.json.encode(verdict.as_mapping())) == verdict.as_mapping()


@pytest.mark.parametrize(
    ("optics", "encoding"),
    [
        (Optics.realistic(), "bayer_rggb8"),
        pytest.param(
            Optics(gamma=2.2, precorrected=False, crosstalk_error=0.1), "rgb8", marks=pytest.mark.long, id="gamma"
        ),
        pytest.param(Optics(noise=3.0), "rgb8", marks=pytest.mark.long, id="noise"),
    ],
)
def test_ordinary_errors_of_colour_noise_and_projector_are_no_inconsistency(optics: Optics, encoding: str):
    images = pair("mixed", optics, encoding)
    cloud = reconstructor(LAYOUT.calibration_for(optics), encoding=encoding).reconstruct(images.left, images.right)
    assert cloud.consistency.verdict in ("consistent", "doubtful"), cloud.consistency.reason
    assert cloud.points > 20_000


@pytest.mark.parametrize(
    ("side", "axis", "degrees", "cause"),
    [
        ("right", YAW, 0.1, "right camera is turned about its vertical axis"),
        pytest.param("right", YAW, -0.1, "right camera is turned about its vertical axis", marks=pytest.mark.long),
        pytest.param("right", YAW, 0.3, "", marks=pytest.mark.long),
        ("right", PITCH, 0.05, "camera is turned about its horizontal axis by 0.0[3-9]"),
        pytest.param("right", PITCH, -0.1, "camera is turned about its horizontal axis", marks=pytest.mark.long),
        ("right", ROLL, 0.05, r"right camera is turned about its optical axis by 0\.0[3-6]"),
        pytest.param("right", ROLL, 0.2, "optical axis", marks=pytest.mark.long),
        ("right", ROLL, 1.0, ""),
        ("projector", YAW, 0.1, r"or the projector by 0\.(09|10)"),
        pytest.param("projector", YAW, 1.0, "", marks=pytest.mark.long),
        ("projector", ROLL, 0.3, ""),
    ],
)
def test_nothing_is_published_when_a_device_has_turned(side: str, axis: tuple, degrees: float, cause: str):
    images = pair("mixed")
    calibration = turned(LAYOUT.calibration_for(STANDARD), side, axis, degrees)
    cloud = reconstructor(calibration).reconstruct(images.left, images.right)
    found = cloud.consistency
    assert found.verdict == "inconsistent", found
    assert cloud.points == 0
    assert np.isnan(cloud.sigma_mm).all()
    assert (cloud.order == -1).all()
    assert found.findings
    assert re.search(cause, found.cause), found.cause


@pytest.mark.parametrize("degrees", [0.03, -0.05])
def test_the_depth_offset_is_the_error_of_the_cloud_if_the_right_camera_has_turned(degrees: float):
    images = pair("mixed")
    calibration = turned(LAYOUT.calibration_for(STANDARD), "right", YAW, degrees)
    cloud = reconstructor(calibration, "warn").reconstruct(images.left, images.right)
    error = float(np.nanmedian(cloud.xyz[..., 2] - images.truth_left.xyz[..., 2]))
    assert cloud.consistency.readings["depth_offset"].value == pytest.approx(error, rel=0.05)
    assert cloud.consistency.verdict == "doubtful"


@pytest.mark.parametrize("degrees", [0.02, pytest.param(-0.03, marks=pytest.mark.long)])
def test_so_is_another_one_if_the_left_camera_has_turned(degrees: float):
    cloud = reconstructor(policy="warn").reconstruct(*images_of_turned_left(LAYOUT, "mixed", degrees))
    error = float(np.nanmedian(cloud.xyz[..., 2] - pair("mixed").truth_left.xyz[..., 2]))
    assert abs(error) > 1.0
    assert cloud.consistency.readings["depth_offset_left"].value == pytest.approx(error, rel=0.1)


def test_a_projector_near_the_right_camera_shows_a_turn_of_the_left_one_as_a_small_offset_which_is_withheld():
    layout = RigLayout(projector_fraction=0.85, baseline_mm=350.0).scaled(0.5)
    for degrees, verdict in ((0.0, "consistent"), (0.1, "inconsistent")):
        checked = CheckedReconstructor(
            Reconstructor(layout.calibration_for(STANDARD), layout.pattern(), layout.volume()), "withhold"
        )
        found = checked.reconstruct(*images_of_turned_left(layout, "mixed", degrees)).consistency
        assert found.verdict == verdict, found
        assert abs(found.readings["column_offset"].value) < LIMITS["column_offset"][0][1]
    assert re.search(r"the left one by 0\.(09|10|11) degrees", found.cause), found.cause


def test_readings_that_are_all_close_to_their_limits_are_refuted_together():
    names = ("column_offset", "column_x", "column_scatter", "epipolar", "order_cost")

    def at(share: float) -> dict[str, Reading]:
        return {name: Reading(share * LIMITS[name][0][1], 0.0) for name in names}

    for readings, verdict in ((at(0.4), "consistent"), (at(0.47), "doubtful"), (at(0.6), "inconsistent")):
        assert judged(readings | {"combined": combined(readings)}).verdict == verdict
    for name in names:
        alone = {"column_offset": Reading(0.0, 0.0)} | {name: at(0.99)[name]}
        assert judged(alone | {"combined": combined(alone)}).verdict != "inconsistent"
    uncertain = {name: Reading(one.value, one.value / 3) for name, one in at(1.5).items()}
    assert combined(uncertain).value == pytest.approx(0.0)
    both = at(0.5) | {"depth_offset": Reading(0.4 * LIMITS["depth_offset"][0][1], 0.0)}
    assert combined(both).value == pytest.approx(combined(at(0.5)).value), (
        "of readings of one quantity the largest counts"
    )


def test_a_projector_near_the_left_camera_shows_a_turn_as_a_small_offset_which_is_withheld():
    layout = RigLayout(projector_fraction=0.15, baseline_mm=350.0).scaled(0.5)
    calibration = layout.calibration_for(STANDARD)
    images = render_pair(layout, build("mixed"), layout.pattern(), STANDARD, 0.0, 5, "rgb8")
    for degrees, verdict in ((0.0, "consistent"), (0.1, "inconsistent")):
        displaced = turned(calibration, "right", YAW, degrees)
        checked = CheckedReconstructor(Reconstructor(displaced, layout.pattern(), layout.volume()), "withhold")
        found = checked.reconstruct(images.left, images.right).consistency
        assert found.verdict == verdict
        assert abs(found.readings["column_offset"].value) < LIMITS["column_offset"][0][1]
    assert re.search(r"right camera is turned about its vertical axis by 0\.(09|10|11)", found.cause)


@functools.cache
def clipped() -> RenderedPair:
    """Bright surfaces, most of them over-exposed: hardly a patch can be measured."""
    case = next(case for case in HARD if case.name == "bright, over-exposed")
    return pair(case.scene, case.optics)


@pytest.mark.parametrize(("degrees", "verdict"), [(0.0, "unknown"), (0.1, "inconsistent")])
def test_where_patches_are_clipped_the_order_search_shows_a_turned_camera(degrees: float, verdict: str):
    images = clipped()
    calibration = turned(LAYOUT.calibration_for(STANDARD), "right", YAW, degrees)
    cloud = reconstructor(calibration).reconstruct(images.left, images.right)
    found = cloud.consistency
    assert found.verdict == verdict, found
    assert "column_offset" not in found.readings
    assert (cloud.points == 0) == (verdict == "inconsistent")
    assert bool(re.search("right camera is turned about its vertical axis by 0.1", found.cause)) == (degrees > 0)


def test_where_half_of_the_patches_cannot_be_measured_others_are_chosen(monkeypatch: pytest.MonkeyPatch):
    images = pair("mixed")
    right = images.right.copy()
    right[: len(right) // 2 + 60] = 255
    right.setflags(write=False)
    cloud = reconstructor(policy="off").reconstruct(images.left, images.right)
    numbers = []
    for draws in (1, 8):
        monkeypatch.setattr(observe, "_DRAWS", draws)
        observer = Observer(LAYOUT.calibration_for(STANDARD), LAYOUT.pattern(), LAYOUT.volume(), patches=40, seed=1)
        numbers.append(len(observer.patches(images.left, right, cloud)))
    assert numbers[0] < 20 <= numbers[1] < 80


def test_the_scan_finds_an_offset_between_two_half_columns():
    """The cost is low within a fraction of a column only: a scan in steps of half a column reads 0.47 here."""
    images = pair("mixed")
    displaced = reconstructor(turned(LAYOUT.calibration_for(STANDARD), "projector", YAW, 0.035), "warn")
    displaced.reconstruct(images.left, images.right)
    expected = np.radians(0.035) * LAYOUT.calibration().projector.matrix[0, 0]
    scan = displaced.inner.scan
    assert abs(scan.offset_px) == pytest.approx(expected, abs=0.15)
    assert scan.relative_cost < 0.2


def test_two_readings_count_together_only_where_both_are_certain_and_agree():
    one, two = Reading(0.040, 0.006), Reading(0.046, 0.002)
    mean = together(one, two)
    assert one.value < mean.value < two.value
    assert mean.sigma < two.sigma
    assert together(Reading(-one.value, one.sigma), Reading(-two.value, two.sigma)).value == -mean.value
    assert together(one, Reading(0.070, 0.002)) == one  # they contradict each other: a lens, not a turn
    uncertain = Reading(0.040, 0.015)
    assert together(uncertain, two) == uncertain


def test_exchanged_cameras_give_no_cloud():
    images = pair("mixed")
    cloud = reconstructor().reconstruct(images.right, images.left)
    assert cloud.consistency.verdict == "inconsistent"
    assert cloud.points == 0


def test_warn_keeps_the_points_and_off_judges_nothing():
    images = pair("mixed")
    calibration = turned(LAYOUT.calibration_for(STANDARD), "right", PITCH, 0.1)
    warned = reconstructor(calibration, "warn").reconstruct(images.left, images.right)
    plain = reconstructor(calibration, "off").reconstruct(images.left, images.right)
    assert warned.consistency.verdict == "inconsistent"
    assert plain.consistency is None
    assert np.array_equal(warned.xyz, plain.xyz, equal_nan=True)


def test_a_device_that_turns_between_two_pairs_is_reported_and_so_is_its_return():
    images = pair("mixed")
    checked = reconstructor()
    assert checked.reconstruct(images.left, images.right).consistency.verdict == "consistent"
    shifted = np.roll(images.right, 3, axis=0)  # a pitch of 0.1 degrees is three rows
    shifted.setflags(write=False)
    moved = [checked.reconstruct(images.left, shifted) for _ in range(3)]
    assert [cloud.consistency.verdict for cloud in moved] == ["inconsistent"] * 3
    back = [checked.reconstruct(images.left, images.right) for _ in range(10)]
    assert back[-1].consistency.verdict == "consistent"


def test_an_empty_scene_is_unknown():
    black = np.zeros((410, 512, 3), np.uint8)
    black.setflags(write=False)
    cloud = reconstructor().reconstruct(black, black)
    assert cloud.consistency.verdict == "unknown"


@pytest.mark.parametrize("name", [name for name in LIMITS if np.isfinite(LIMITS[name][0]).all()])
def test_a_reading_is_judged_by_its_limits_and_only_when_it_is_certain(name: str):
    doubtful, inconsistent = LIMITS[name][0]
    clean = {"column_offset": Reading(0.0, 0.0)}
    for value, verdict in (
        (0.9 * doubtful, "consistent"),
        (1.01 * doubtful, "doubtful"),
        (1.01 * inconsistent, "inconsistent"),
    ):
        assert judged(clean | {name: Reading(value, 0.0)}).verdict == verdict
        assert judged(clean | {name: Reading(-value, 0.0)}).verdict == verdict
    assert judged(clean | {name: Reading(1.01 * inconsistent, inconsistent)}).verdict == "consistent"
    [finding] = judged(clean | {name: Reading(2 * inconsistent, 0.0)}).findings
    assert finding.startswith(name)
    assert f"limit {inconsistent:g}" in finding


@pytest.mark.parametrize("patches", [16, 60])
def test_a_scatter_is_compared_with_that_of_a_rig_at_the_limit(patches: int):
    limit = LIMITS["column_scatter"][0][1]
    largest = limit * (1 + 4 / np.sqrt(2 * patches))
    for value, verdict in ((0.99 * largest, "doubtful"), (1.01 * largest, "inconsistent")):
        read = Reading(value, value / np.sqrt(2 * patches))
        assert judged({"column_offset": Reading(0.0, 0.0), "column_scatter": read}).verdict == verdict


def test_a_scan_finds_the_offset_with_the_least_cost_and_its_share_of_unrelated_phases():
    offsets = np.arange(-6.0, 7.0)
    costs = [np.full(500, 0.3, np.float32) for _ in offsets]
    costs[9][:] = 0.06
    scan = ColumnScan.of(offsets, costs, 2.0, {0: 0.1, 1: 0.091, -3: 0.0901}, costs[6], 0.0, 0.3)
    assert (scan.offset_px, scan.cost) == (3.0, pytest.approx(0.06))
    assert abs(scan.allowed_px) <= 2
    assert (scan.relative_cost, scan.used_relative) == (pytest.approx(1.0), pytest.approx(1.0))
    assert (scan.used_cost, scan.unrelated) == (pytest.approx(0.3), pytest.approx(0.3))
    assert scan.across_px == 0.0  # no displacement costs clearly less than none
    assert ColumnScan.of(offsets, costs, 2.0, {0: 0.1, 1: 0.09, -3: 0.08}, costs[6], 0.0, 0.3).across_px == -3.0
    assert ColumnScan.of(offsets, costs, 2.0, {0: 0.1}, costs[6], 0.0, np.nan) is None
    assert ColumnScan.of(offsets, [cost[:10] for cost in costs], 2.0, {0: 0.1}, costs[6], 0.0, 0.3) is None


def test_costs_count_as_far_as_they_exceed_that_of_noise():
    offsets = np.arange(-6.0, 7.0)
    for here, elsewhere, share in ((1.0, 2.0, 0.0), (2.0, 3.0, 0.5), (3.0, 3.0, 1.0), (0.5, 0.8, 0.0)):
        costs = [np.full(500, elsewhere * NOISE_COST, np.float32) for _ in offsets]
        costs[6][:] = here * NOISE_COST
        scan = ColumnScan.of(offsets, costs, 2.0, {0: 0.1}, costs[6], 0.0, 0.3)
        assert scan.relative_cost == pytest.approx(share, abs=1e-4)


@pytest.mark.parametrize(
    ("agreeing", "roll", "verdict", "name"),
    [
        (0, 0.0, "inconsistent", "order_cost"),
        (40, 0.0, "doubtful", "order_cost_beside_agreement"),
        (40, 0.3, "inconsistent", "order_cost"),
    ],
)
def test_a_high_cost_refutes_nothing_where_patches_and_some_pixels_agree(
    agreeing: int, roll: float, verdict: str, name: str
):
    rng = np.random.default_rng(4)
    offsets = np.arange(-6.0, 7.0)
    costs = [rng.exponential(0.1, 500).astype(np.float32) for _ in offsets]
    corrected = costs[6].copy()
    corrected[:agreeing] = rng.exponential(0.003, agreeing)
    scan = ColumnScan.of(offsets, costs, 2.0, {0: 0.1}, corrected, 0.0, 0.1)
    images = pair("mixed")
    checked = reconstructor(turned(LAYOUT.calibration_for(STANDARD), "projector", ROLL, roll), "off")
    cloud = checked.reconstruct(images.left, images.right)
    found = checked.new_check().check(images.left, images.right, cloud, scan)
    assert found.readings[name].value > 0.8
    assert found.verdict == verdict, found


@pytest.mark.parametrize(
    ("used_px", "agreeing", "verdict"),
    [(0.0, 0, "inconsistent"), (1.9, 0, "consistent"), (0.0, 60, "consistent")],
    ids=["moved", "the offset in use", "some pixels agree up to noise at the offset in use"],
)
def test_columns_that_fit_clearly_better_at_another_offset_are_refuted(used_px: float, agreeing: int, verdict: str):
    rng = np.random.default_rng(4)
    offsets = np.arange(-6.0, 7.0)
    costs = [rng.exponential(0.1, 500).astype(np.float32) for _ in offsets]
    costs[8] = rng.exponential(0.01, 500).astype(np.float32)
    corrected = costs[6].copy()
    corrected[:agreeing] = rng.exponential(0.001, agreeing)
    scan = ColumnScan.of(offsets, costs, 2.0, {0: 0.1}, corrected, used_px, 0.1)
    images = pair("mixed")
    checked = reconstructor(policy="off")
    found = checked.new_check().check(
        images.left, images.right, checked.reconstruct(images.left, images.right), scan
    )  # fmt: skip
    assert found.verdict == verdict, found
    assert ("scanned_change" in found.readings) == (verdict == "inconsistent")


@pytest.mark.parametrize("degrees", [0.1, -0.2, 0.5])
def test_a_pitch_is_measured_by_the_displacement_at_which_the_fringes_agree_best(degrees: float):
    images = pair("mixed")
    displaced = reconstructor(turned(LAYOUT.calibration_for(STANDARD), "right", PITCH, degrees), "warn")
    found = displaced.reconstruct(images.left, images.right).consistency
    assert found.verdict == "inconsistent"
    reading = found.readings["scanned_epipolar"].value
    assert abs(reading) == pytest.approx(abs(degrees), rel=0.45)  # displacements are tried in such steps


@pytest.mark.long
def test_fringes_without_slope_across_the_epipolar_lines_are_no_evidence_of_a_pitch():
    """Wide fringes: a bias of the phase by some milliradians would be a displacement of several pixels."""
    case = scaled(next(case for case in HARD if case.name == "plaster cast, wide fringes"), 0.5)
    counts = render_counts(case.layout, build(case.scene, seed=1), case.pattern, case.optics, encoding=case.encoding)
    made = Reconstructor(case.layout.calibration_for(case.optics), case.pattern, case.layout.volume())
    found = CheckedReconstructor(made).reconstruct(*with_noise(counts, case.optics, 8, case.encoding)).consistency
    assert found.verdict == "consistent", found.reason
    assert found.readings["epipolar"].sigma > 0.05  # degrees; the scatter of the patches alone gives 0.017
