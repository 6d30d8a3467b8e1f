"""The truth agrees with the reference camera model, and visibility with plain geometry."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.pattern.color_fringe import ColorFringe
from sim.render import render_pair
from sim.render.ground_truth import phases
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene import named_scenes
from sim.scene.scene import Scene
from sim.scene.shapes import COLORED, Motion, box, cylinder, plane, rectangle, relief, sphere

SCENES = ("plane", "spheres", "steps", "face", "isolated", "mixed", "moving")


@pytest.fixture(scope="module", params=SCENES)
def seen(request, small):
    return render_pair.truths(small, named_scenes.build(request.param), small.pattern(), 0.4)


def test_every_true_point_projects_to_its_own_pixel(seen, small):
    rig = small.calibration()
    for truth, camera in zip(seen, (rig.left, rig.right), strict=True):
        v, u = np.mgrid[0 : camera.size[1], 0 : camera.size[0]]
        away = camera.project(truth.xyz.astype(np.float64)) - np.stack([u, v], axis=-1)
        assert truth.hit.any()
        assert np.nanmax(np.abs(away)) < 1e-3


def test_the_projector_coordinate_is_that_of_the_reference_model(seen, small):
    projector = small.calibration().projector
    for truth in seen:
        away = projector.project(truth.xyz.astype(np.float64)) - truth.projector
        assert np.nanmax(np.abs(away)) < 1e-3
        assert np.array_equal(truth.hit, np.isfinite(truth.projector[..., 0]))


def test_orders_count_the_periods_of_the_projector_coordinate(seen, small):
    pattern = small.pattern()
    for truth in seen:
        period = pattern.length / pattern.periods
        expected = np.floor((truth.projector[..., 0].astype(np.float64) + 0.5) / period)
        known = truth.order >= 0
        close = np.abs(expected - truth.order)[known] == 0
        assert close.mean() > 0.999  # the rest lies on a boundary, to float32
        assert not known[~truth.hit].any()
        assert known[truth.lit].all()


def test_masks_are_nested(seen):
    for truth in seen:
        assert not (truth.lit & ~truth.hit).any()
        assert not (truth.seen_by_both & ~truth.hit).any()
        assert np.array_equal(truth.scorable, truth.lit & truth.seen_by_both)


def test_scenes_stay_inside_the_measuring_volume():
    layout = RigLayout().scaled(0.06)
    volume = layout.volume()
    for name in SCENES:
        scene = named_scenes.build(name)
        for share in (0.0, 0.25, 0.5, 0.75) if scene.moves else (0.0,):
            z = render_pair.truths(layout, scene, t_s=share * scene.period_s)[0].xyz[..., 2]
            assert np.nanmin(z) > volume.near_mm, (name, share)
            assert np.nanmax(z) < volume.far_mm, (name, share)


def _hidden_by_ball(points, viewer, centre, radius):
    """Whether a ball cuts the straight line from each point to the viewer."""
    along = viewer - points
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    along = along / length
    nearest = np.clip(np.sum((centre - points) * along, axis=-1, keepdims=True), 0, length)
    return np.linalg.norm(points + nearest * along - centre, axis=-1) < radius


def test_shadow_and_occlusion_behind_a_ball_are_those_of_geometry(small):
    scene = Scene("ball", (plane().placed((0, 0, 60)), sphere(35).placed((10, 5, -20))))
    truth, _ = render_pair.truths(small, scene)
    rig, (rotation, origin) = small.calibration(), small.stage_pose()
    centre = rotation @ np.array([10.0, 5.0, -20.0]) + origin
    xyz = truth.xyz.astype(np.float64)
    wall = np.linalg.norm(xyz - centre, axis=-1) > 35.5
    shadow = _hidden_by_ball(xyz, rig.projector.centre, centre, 35.0)
    covered = _hidden_by_ball(xyz, rig.right.centre, centre, 35.0)
    assert shadow[wall].sum() > 50
    assert not truth.lit[wall & shadow].any()
    inside = (truth.projector > 1).all(axis=-1) & (truth.projector < np.array(small.projector_size) - 2).all(axis=-1)
    assert truth.lit[wall & ~shadow & inside].all()
    assert not truth.seen_by_both[wall & covered].any()
    right = rig.right.project(xyz)
    in_right = (right > 1).all(axis=-1) & (right < np.array(small.camera_size) - 2).all(axis=-1)
    assert truth.seen_by_both[wall & ~covered & in_right].all()


def test_the_far_side_of_a_ball_is_dark(small):
    truth, _ = render_pair.truths(small, Scene("ball", (sphere(60).placed(),)))
    rig, (_, origin) = small.calibration(), small.stage_pose()
    normal = (truth.xyz - origin) / 60
    facing = np.sum(normal * (rig.projector.centre - truth.xyz), axis=-1)
    assert not truth.lit[truth.hit & (facing < -1)].any()
    assert truth.lit[truth.hit & (facing > 1)].all()
    assert (truth.hit & (facing < -1)).any()


def _distance(shape, local):
    """How far points in a shape's frame are from its surface, mm."""
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    d = shape.dims
    if shape.kind == box(1, 1, 1).kind:
        return np.abs(np.max(np.abs(local) - np.array(d), axis=-1))
    if shape.kind == cylinder(1, 1).kind:
        return np.abs(np.maximum(np.hypot(x, z) - d[0], np.abs(y) - d[1]))
    if shape.kind == rectangle(1, 1).kind:
        return np.maximum(np.abs(z), np.maximum(np.abs(x) - d[0], np.abs(y) - d[1]))
    return np.abs(np.linalg.norm(local, axis=-1) - d[0])


@pytest.mark.parametrize("shape", [box(90, 60, 70), cylinder(30, 120), rectangle(150, 120), sphere(55)])
def test_hits_lie_on_the_surface_of_turned_and_moving_shapes(shape, small):
    placed = shape.placed((12, -7, 9), turn=(0.3, 0.7, -0.2), motion=Motion((15, 4, -8), 0.4, (1.0, 0.3, 0.0)))
    scene = Scene("one", (placed,), period_s=2.0)
    truth, _ = render_pair.truths(small, scene, t_s=0.31)
    rotation, origin = small.stage_pose()
    turn, place = placed.pose(scene.share(0.31))
    local = ((truth.xyz[truth.hit].astype(np.float64) - origin) @ rotation - place) @ turn
    assert len(local) > 200
    assert _distance(shape, local).max() < 1e-3


@pytest.mark.parametrize("variant", ["face", "waves"])
def test_reliefs_are_met_at_their_surface_and_nowhere_before(variant, small):
    from sim.scene.ray_intersection import relief_height

    shape = relief(170, 230, 70, variant=variant).placed((0, 0, 35), turn=(0.1, 0.5, 0.0))
    truth, _ = render_pair.truths(small, Scene("one", (shape,)))
    rotation, origin = small.stage_pose()
    turn, place = shape.pose(0)

    def gap(points):
        local = ((points - origin) @ rotation - place) @ turn
        number = 0.0 if variant == "face" else 1.0
        height = [relief_height(number, x / 85, y / 115) for x, y, _ in local]
        return -local[:, 2] - 70 * np.array(height)

    points = truth.xyz[truth.hit].astype(np.float64)
    assert len(points) > 1000
    assert np.abs(gap(points)).max() < 2e-3
    for share in np.linspace(0.93, 0.999, 30):
        assert (gap(share * points) > -1e-3)[np.abs((share * points - origin) @ rotation[:, 0]) < 60].mean() > 0.995


def test_a_supersampled_image_is_lit_where_the_truth_is_lit(small):
    scene = named_scenes.build("spheres")
    pair = render_pair.render_pair(small, scene, np.full((128, 160, 3), 255, np.uint8), Optics.ideal())
    inner = cv2.erode(pair.truth_left.lit.astype(np.uint8), np.ones((3, 3))) > 0
    dark = cv2.erode((~pair.truth_left.lit).astype(np.uint8), np.ones((3, 3))) > 0
    grazing = pair.left[inner].max(axis=-1) == 0
    assert grazing.mean() < 0.01
    assert pair.left[dark].max() == 0


@pytest.mark.parametrize("name", ["spheres", "face"])
def test_noise_free_phase_is_the_phase_of_the_truth(name, small):
    scene = named_scenes.build(name)
    white = tuple(s.placed(s.at_mm, turn=s.turn, albedo=0.8, motion=s.motion) for s in scene.shapes)
    pattern: ColorFringe = small.pattern()
    counts = render_pair.render_counts(small, Scene(name, white), pattern, Optics.ideal(supersampling=4))
    for image, truth in zip(counts, render_pair.truths(small, Scene(name, white), pattern), strict=True):
        red, green, blue = (image[..., c].astype(np.float64) for c in range(3))
        phase = np.arctan2(np.sqrt(3) * (red - blue), 2 * green - red - blue)
        error = np.angle(np.exp(1j * (phase - phases(truth.projector.astype(np.float64), pattern))))
        z = np.nan_to_num(truth.xyz[..., 2])
        steep = cv2.morphologyEx(z, cv2.MORPH_GRADIENT, np.ones((5, 5))) > 14
        inner = cv2.erode(truth.lit.astype(np.uint8), np.ones((5, 5))) > 0
        judged = inner & ~steep
        assert judged.sum() > 1000
        assert np.abs(error[judged]).max() < 0.05


def test_frequency_modulated_patterns_have_orders_of_their_own_table(small):
    from pipeline.pattern.color_fringe import modulated_profile

    pattern = small.pattern(profile=modulated_profile(160, 12))
    truth, _ = render_pair.truths(small, named_scenes.build("plane"), pattern)
    table = np.floor(pattern.phase / (2 * np.pi))
    columns = np.clip(np.rint(truth.projector[..., 0]), 0, 159).astype(int)
    assert np.abs(truth.order - table[columns])[truth.lit].max() <= 1


def test_textures_move_with_the_shape(small):
    flat = np.full((128, 160, 3), 200, np.uint8)
    shape = rectangle(120, 120).placed((0, 0, 0), texture=COLORED, motion=Motion(swing_mm=(30, 0, 0)))
    scene = Scene("one", (shape,), period_s=4.0)
    optics = Optics.ideal(exposure_us=1.0)
    still, moved = (render_pair.render_counts(small, scene, flat, optics, t_s)[0] for t_s in (0.0, 1.0))
    shift = round(30 * small.focal_px / small.standoff_mm * 0.984)
    both = np.abs(still[30:70, 45:80] - moved[30:70, 45 + shift : 80 + shift])
    elsewhere = np.abs(still[30:70, 45:80] - moved[30:70, 45:80])
    assert np.median(both) < 0.3 * np.median(elsewhere)
