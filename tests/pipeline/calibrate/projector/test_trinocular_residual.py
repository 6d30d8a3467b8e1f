"""Refinement of the projector from points: disturbances are corrected, sigma is right, bad samples are refused."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibrate.projector.trinocular_residual import (
    DEFAULT_PRIOR,
    LENS_PRIOR,
    Samples,
    joined,
    moved,
    refine_projector,
    residuals,
    rotation_of,
    spread,
)
from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout

RIG = RigLayout().calibration()
DISTURBANCE = {"cx": 0.5, "rotation_y": np.deg2rad(0.01), "rotation_x": -np.deg2rad(0.01), "focal": 1e-4}
NOISE_PX = 0.06


def _samples(n: int, *, axes: tuple[int, ...] = (0,), noise_px: float = NOISE_PX, seed: int = 0) -> Samples:
    """Points of a bumpy surface in the measuring volume, lit by the true projector."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-190, 190, n), rng.uniform(-150, 150, n)
    z = 1400 + 0.2 * x + 50 * np.sin(x / 60) * np.cos(y / 45)
    points = np.stack([x, y, z], axis=1)
    axis = rng.choice(axes, n)
    true = RIG.projector.project(points)[np.arange(n), axis]
    return Samples(points, true + noise_px * rng.standard_normal(n), axis, np.full(n, noise_px))


def _disturbed(changes: dict[str, float]) -> Calibration:
    return Calibration(RIG.left, RIG.right, moved(RIG.projector, changes))


def _error_px(projector: CameraModel, samples: Samples) -> float:
    """Error of the projector's columns at the samples' points against the truth."""
    columns = projector.project(samples.points) - RIG.projector.project(samples.points)
    return float(np.sqrt((columns[:, 0] ** 2).mean()))


def test_the_true_projector_leaves_no_residual() -> None:
    samples = _samples(500, axes=(0, 1), noise_px=0.0)
    samples = Samples(samples.points, samples.observed, samples.axis, np.ones(500))
    np.testing.assert_allclose(residuals(RIG.projector, samples), 0.0, atol=1e-9)


def test_a_disturbed_projector_is_corrected_to_the_noise() -> None:
    samples = _samples(6000)
    got = refine_projector(_disturbed(DISTURBANCE), samples)
    assert got.before.systematic_px > 0.3
    assert got.after.systematic_px < 0.01
    assert got.after_px == pytest.approx(NOISE_PX, rel=0.05)
    assert got.better
    assert {"cx", "rotation_y"} & set(got.changed)
    assert _error_px(got.calibration.projector, samples) < 0.005
    assert _error_px(got.calibration.projector, _samples(500, seed=9)) < 0.005


def test_the_cameras_and_colours_stay_as_they_are() -> None:
    before = _disturbed(DISTURBANCE)
    after = refine_projector(before, _samples(2000)).calibration
    assert after.left is before.left
    assert after.right is before.right
    assert after.left_color is before.left_color


def test_what_the_samples_do_not_determine_stays_unchanged() -> None:
    # Columns alone hardly determine rotations about the projector's own horizontal axis or of its rows.
    got = refine_projector(_disturbed({"cx": 0.5}), _samples(4000))
    assert abs(got.changes["cy"]) < 0.2
    assert got.sigma["cy"] > 0.5 * DEFAULT_PRIOR["cy"]
    assert "cy" not in got.changed
    assert "cy" not in got.supported
    both = refine_projector(_disturbed({"cx": 0.5, "cy": -0.6}), _samples(4000, axes=(0, 1)))
    rows = both.calibration.projector.project(_samples(500).points) - RIG.projector.project(_samples(500).points)
    assert np.abs(rows).max() < 0.02


def test_nothing_is_changed_where_nothing_is_wrong() -> None:
    got = refine_projector(RIG, _samples(4000))
    assert not got.changed
    assert max(got.effect_px.values()) < 0.02
    assert _error_px(got.calibration.projector, _samples(500, seed=5)) < 0.005


def test_the_scatter_of_the_changes_agrees_with_their_sigma() -> None:
    ratios = []
    for seed in range(12):
        got = refine_projector(_disturbed(DISTURBANCE), _samples(1500, seed=seed))
        prior = np.array(list(got.prior.values()))
        # The mixtures of parameters that columns know best, in units of the prior.
        variance, mixtures = np.linalg.eigh(got.covariance / np.outer(prior, prior))
        error = np.array([value + DISTURBANCE.get(name, 0.0) for name, value in got.changes.items()]) / prior
        ratios.append((mixtures.T @ error)[:2] / np.sqrt(variance[:2]))
    assert 0.7 < np.std(ratios) < 1.4


def test_wrong_orders_and_edges_do_not_matter() -> None:
    samples = _samples(6000)
    rng = np.random.default_rng(8)
    wild = samples.observed + np.where(rng.random(6000) < 0.1, 13.3 * rng.integers(-1, 2, 6000), 0.0)
    got = refine_projector(_disturbed(DISTURBANCE), Samples(samples.points, wild, samples.axis, samples.sigma_px))
    assert _error_px(got.calibration.projector, samples) < 0.01
    assert got.after.wrong == pytest.approx(0.067, abs=0.03)


def test_unknown_points_are_ignored() -> None:
    samples = _samples(3000)
    points = samples.points.copy()
    points[::7] = np.nan
    got = refine_projector(_disturbed(DISTURBANCE), Samples(points, samples.observed, samples.axis, samples.sigma_px))
    assert got.after.systematic_px < 0.015


def test_a_lens_is_refined_only_on_request() -> None:
    bent = _disturbed({"k1": 0.02})
    samples = joined(_samples(8000, axes=(0, 1)), _samples(4000, axes=(0, 1), seed=2))
    stiff = refine_projector(bent, samples)
    free = refine_projector(bent, samples, prior={**DEFAULT_PRIOR, **LENS_PRIOR})
    assert free.after.systematic_px < 0.01
    assert free.after.systematic_px < stiff.after.systematic_px
    assert "k1" in free.changed


def test_moving_back_and_forth_changes_nothing() -> None:
    vector = np.array([0.3, -0.2, 0.7])
    np.testing.assert_allclose(rotation_of(vector) @ rotation_of(-vector), np.eye(3), atol=1e-14)
    np.testing.assert_allclose(moved(RIG.projector, {}).matrix, RIG.projector.matrix)
    turned = moved(RIG.projector, {"rotation_x": 0.01})
    np.testing.assert_allclose(turned.centre, RIG.projector.centre, atol=1e-9)


def test_insufficient_samples_are_refused_with_the_reason() -> None:
    with pytest.raises(CalibrationError, match="at least 300"):
        refine_projector(RIG, _samples(200))
    samples = _samples(2000)
    with pytest.raises(CalibrationError, match="calibrate again"):
        refine_projector(_disturbed({"cx": 30.0}), samples)
    middle = np.hypot(samples.points[:, 0], samples.points[:, 1]) < 25
    dense = joined(*[samples.some(middle)] * 40)
    with pytest.raises(CalibrationError, match="larger surface"):
        refine_projector(RIG, dense)
    with pytest.raises(CalibrationError, match="unknown or no parameters"):
        refine_projector(RIG, samples, prior={"warp": 1.0})
    with pytest.raises(CalibrationError, match="do not agree"):
        Samples(samples.points, samples.observed[:5], samples.axis, samples.sigma_px)


def test_the_spread_separates_noise_from_the_systematic_residual() -> None:
    samples = _samples(20000)
    still = spread(RIG.projector, samples)
    assert still.rms_px == pytest.approx(NOISE_PX, rel=0.03)
    assert still.systematic_px < 0.004
    shifted = spread(moved(RIG.projector, {"cx": 0.2}), samples)
    assert shifted.systematic_px == pytest.approx(0.2, abs=0.005)
    assert shifted.worst_px == pytest.approx(0.2, abs=0.03)
