"""Scores after a rigid alignment see shape and size, and neither where a cloud stands nor its few wrong points."""

from __future__ import annotations

import numpy as np
import pytest

from sim.evaluate.score import aligned, best_motion, score
from sim.render import render_pair
from sim.scene import named_scenes
from sim.scene.shapes import rotation_about

TURN = rotation_about((0.3, -1.0, 0.2), np.radians(0.4))
SHIFT = np.array([1.5, -0.8, 3.0])


@pytest.fixture(scope="module")
def truth(quarter):
    return render_pair.truths(quarter, named_scenes.build("spheres"))[0]


def moved(xyz):
    return ((xyz.astype(np.float64) - SHIFT) @ TURN).astype(np.float32)


def test_a_cloud_that_was_only_moved_has_no_error(truth):
    found = aligned(moved(truth.xyz), truth)
    assert found.alignment.rotation == pytest.approx(TURN, abs=1e-7)
    assert found.alignment.translation == pytest.approx(SHIFT, abs=1e-3)
    assert found.alignment.angle_deg == pytest.approx(0.4, abs=1e-4)
    assert found.alignment.scale == pytest.approx(1, abs=1e-6)
    assert found.score.rms_mm < 1e-3
    assert found.score.reconstructed == 1.0


def test_a_cloud_of_another_size_is_wrong_by_its_size(truth):
    found = aligned(moved(truth.xyz * np.float32(1.002)), truth)
    points = truth.xyz[truth.hit].astype(np.float64)
    spread = np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert found.alignment.scale == pytest.approx(1 / 1.002, rel=1e-5)
    assert found.score.rms_mm == pytest.approx(0.002 * spread, rel=0.05)


def test_wrong_points_and_noise_do_not_move_the_cloud(truth):
    rng = np.random.default_rng(2)
    ray = truth.xyz / np.linalg.norm(truth.xyz, axis=-1, keepdims=True)
    noisy = truth.xyz + ray * rng.normal(0, 0.1, truth.xyz.shape[:2])[..., None]
    wrong = rng.random(truth.xyz.shape[:2]) < 0.2
    noisy[wrong] += (ray * rng.uniform(5, 60, wrong.shape)[..., None])[wrong]
    noisy[rng.random(wrong.shape) < 0.3] = np.nan
    found = aligned(moved(noisy.astype(np.float32)), truth)
    assert found.alignment.rotation == pytest.approx(TURN, abs=2e-5)
    assert found.score.rms_mm == pytest.approx(0.1, rel=0.03)
    assert found.score.wrong == pytest.approx(0.2, abs=0.03)
    assert score(noisy.astype(np.float32), truth).rms_mm == pytest.approx(found.score.rms_mm, rel=0.01)


def test_a_mirrored_cloud_is_not_laid_upon_the_truth(truth):
    mirrored = truth.xyz * np.array([-1, 1, 1], np.float32)
    motion = best_motion(mirrored, truth)
    assert np.linalg.det(motion.rotation) == pytest.approx(1)
    assert aligned(mirrored, truth).score.reconstructed < 0.9


def test_too_few_points_raise_an_error(truth):
    empty = np.full_like(truth.xyz, np.nan)
    with pytest.raises(ValueError, match="0 points have a truth"):
        aligned(empty, truth)
