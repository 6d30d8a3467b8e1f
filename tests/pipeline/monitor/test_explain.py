"""A small rotation of a device is recovered from its readings, and rotated calibrations are consistent."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.monitor.explain import DEVICES, GEOMETRY, Rotation, explain, rotated, signature, unambiguous
from pipeline.monitor.observe import Reading
from pipeline.monitor.patches import SHAPE
from sim.rig.layout import RigLayout

RIG = RigLayout().calibration()


def patches(n: int = 200) -> np.ndarray:
    """Points of the volume and fringes that lean a little, as a scene with relief has them."""
    rng = np.random.default_rng(5)
    shape = np.zeros((n, SHAPE))
    pixels = rng.uniform([50, 50], [970, 770], (n, 2))
    shape[:, :3] = np.concatenate([RIG.left.normalise(pixels), np.ones((n, 1))], axis=1) * rng.uniform(
        1330, 1480, (n, 1)
    )
    shape[:, 8] = 0.55 + 0.05 * rng.standard_normal(n)
    shape[:, 9] = 0.04 * rng.standard_normal(n)
    return shape


@pytest.mark.parametrize("device", DEVICES)
def test_the_inverse_rotation_restores_the_calibration(device: str) -> None:
    there = rotated(RIG, device, (0.1, -0.2, 0.15))
    back = rotated(there, device, (-0.1, 0.2, -0.15))
    for name in ("right", "projector"):
        one, two = getattr(back, name), getattr(RIG, name)
        assert (
            np.abs(one.rotation - two.rotation).max() < 1e-12 and np.abs(one.translation - two.translation).max() < 1e-9
        )
    assert there.baseline_mm == pytest.approx(RIG.baseline_mm, rel=1e-12)


def test_a_rotated_left_camera_images_the_same_points_elsewhere() -> None:
    points = patches()[:, :3]
    there = rotated(RIG, "left", (0.0, 0.3, 0.0))
    rotation = np.array([[np.cos(np.deg2rad(0.3)), 0, np.sin(np.deg2rad(0.3))], [0, 1, 0], [0, 0, 1]])
    rotation[2] = -rotation[0, 2], 0, rotation[0, 0]
    assert np.abs(there.right.project(points @ rotation.T) - RIG.right.project(points)).max() < 1e-9


@pytest.mark.parametrize("device", DEVICES)
def test_the_rotation_is_recovered_from_its_readings(device: str) -> None:
    shape = patches()
    truth = np.array([0.004, 0.01, -0.006])
    change = signature(RIG, shape, 0, device) @ truth
    sigma = dict(zip(GEOMETRY, (1e-4, 1e-4, 1e-4, 2e-3), strict=True))
    found = explain(RIG, shape, 0, {n: Reading(float(v), sigma[n]) for n, v in zip(GEOMETRY, change, strict=True)})
    one = next(rotation for rotation in found if rotation.device == device)
    assert one.misfit < 1
    # The projector's pitch hardly moves its columns: its sigma is mostly that of the prior.
    observable = slice(1, 3) if device == "projector" else slice(0, 3)
    error = np.abs(np.array(one.angle_deg) - truth)[observable]
    assert (error < 3 * np.array(one.sigma_deg)[observable] + 0.001).all(), one


def test_the_device_is_named_only_when_it_is_the_only_one() -> None:
    small, large, poor = (0.01, 0.0, 0.0), (0.2, 0.0, 0.0), 80.0
    none = (0.1, 0.1, 0.1)
    assert unambiguous([Rotation("left", small, none, 1.0), Rotation("right", small, none, 2.0)]) is None
    only = unambiguous(
        [
            Rotation("left", small, none, 1.0),
            Rotation("projector", large, none, 2.0),
            Rotation("right", small, none, 90.0),
        ]
    )
    assert only is not None and only.device == "left"
    assert unambiguous([Rotation(device, small, none, poor) for device in DEVICES]) is None
