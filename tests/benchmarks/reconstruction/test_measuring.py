"""Scores of the benchmark: phases, lattices, and a job in a process of its own."""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction import rendered, scale
from benchmarks.reconstruction.cases import Case
from benchmarks.reconstruction.compare import phase_error
from benchmarks.reconstruction.rendered import StoredPair
from benchmarks.reconstruction.speed import mean_score, scored, timed
from benchmarks.reconstruction.worker import forth_and_back
from sim.evaluate.score import score
from sim.render.ground_truth import phases
from sim.rig.layout import RigLayout

SMALL = Case("small", "plane", layout=RigLayout().scaled(0.25), periods=24.0)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> StoredPair:
    return rendered.stored_pair(SMALL, folder=tmp_path_factory.mktemp("images"))


@pytest.fixture(scope="module")
def true_phase(pair: StoredPair) -> np.ndarray:
    return phases(pair.truth_left.projector.astype(np.float64), SMALL.pattern)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("constant", [0.0, 2.9, 40.0])
def test_sign_and_constant_of_a_relative_phase_do_not_matter(
    pair: StoredPair, true_phase: np.ndarray, sign: int, constant: float
) -> None:
    found = phase_error(sign * true_phase + constant, pair.truth_left, SMALL)
    assert found.rms_rad < 1e-6 and found.order == 1


def test_pixels_of_another_period_and_unknown_ones_are_not_right(pair: StoredPair, true_phase: np.ndarray) -> None:
    places = np.flatnonzero(pair.truth_left.scorable)
    phase = true_phase.copy()
    phase.flat[places[: len(places) // 4]] += 2 * np.pi
    phase.flat[places[-len(places) // 4 :]] = np.nan
    found = phase_error(phase, pair.truth_left, SMALL)
    assert found.order == pytest.approx(0.5, abs=1e-3) and found.rms_rad < 1e-6


def test_a_phase_without_a_single_known_pixel_is_no_phase(pair: StoredPair, true_phase: np.ndarray) -> None:
    found = phase_error(np.full_like(true_phase, np.nan), pair.truth_left, SMALL)
    assert found.order == 0 and math.isinf(found.rms_rad)


def test_a_cloud_on_a_lattice_is_scored_on_its_lattice(pair: StoredPair) -> None:
    truth = pair.truth_left
    xyz = np.full_like(truth.xyz, np.nan)
    xyz[::2, ::2] = truth.xyz[::2, ::2]
    assert scored(xyz, truth, 2).reconstructed == 1
    assert scored(xyz[::2, ::2], truth, 2).reconstructed == 1
    assert astuple(scored(xyz, truth, 1)) == pytest.approx(astuple(score(xyz, truth)), nan_ok=True)
    assert scored(xyz, truth, 1).reconstructed == pytest.approx(0.25, abs=0.01)


def test_the_mean_of_equal_scores_is_each_of_them(pair: StoredPair) -> None:
    one = score(pair.truth_left.xyz, pair.truth_left)
    assert astuple(mean_score([one] * 3)) == pytest.approx(astuple(one))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_images_are_played_forth_and_back(count: int) -> None:
    shown = list(itertools.islice(forth_and_back(count), 4 * count + 1))
    assert set(shown) == set(range(count))
    assert all(abs(b - a) == min(1, count - 1) for a, b in itertools.pairwise(shown))


def test_images_are_rendered_once_and_depth_does_not_matter(tmp_path: Path) -> None:
    case = replace(SMALL, layout=RigLayout().scaled(0.05), periods=4.0)
    first = rendered.stored_pair(case, folder=tmp_path)
    deeper = replace(case, layout=replace(case.layout, depth_mm=300.0))
    stamp = first.file.stat().st_mtime_ns
    again = rendered.stored_pair(deeper, folder=tmp_path)
    assert again.file == first.file and first.file.stat().st_mtime_ns == stamp
    assert np.array_equal(again.left, first.left) and np.array_equal(again.truth_left.xyz, first.truth_left.xyz, True)
    assert rendered.stored_pair(case, seed=1, folder=tmp_path).file != first.file
    assert len(list(tmp_path.iterdir())) == 2


def test_more_pixels_have_the_same_field_of_view() -> None:
    for width, height in scale.SIZES:
        rig = scale.with_pixels(width, height).calibration().left
        standard = scale.STANDARD.calibration().left
        assert rig.size == (width, height)
        assert width / rig.matrix[0, 0] == pytest.approx(standard.size[0] / standard.matrix[0, 0])


def test_every_series_holds_the_standard_case() -> None:
    for quick in (False, True):
        for series in scale.every_series(quick=quick):
            same = [
                c for _, _, c in series.points if c.layout == scale.STANDARD and c.periods == scale.STANDARD.periods
            ]
            assert len(same) == 1, series.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"use_prior": True}, *(pytest.param(options, marks=pytest.mark.long) for options in ({"stride": 2}, {}))],
    ids=str,
)
def test_a_job_is_timed_in_a_process_of_its_own(pair: StoredPair, tmp_path: Path, options: dict[str, object]) -> None:
    timing = timed(SMALL, [pair], 1, 3, clouds=tmp_path, **options)
    assert len(timing.total_ms) == 3 and all(len(ms) == 3 for ms in timing.stage_ms.values())
    assert sum(ms[0] for ms in timing.stage_ms.values()) <= timing.total_ms[0] + 1e-3
    assert timing.peak_mib > timing.images_mib > 0 and timing.ready_s > 0
    cloud = np.load(tmp_path / "0.npy")
    assert scored(cloud, pair.truth_left, int(options.get("stride", 1))).reconstructed > 0.9  # type: ignore[call-overload]
