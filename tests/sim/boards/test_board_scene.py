"""Printed boards in the simulator's images stand where exact projection puts them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board
from pipeline.calibrate.targets.board.charuco_board import charuco
from pipeline.pattern.projected_frames import Fringe, Uniform
from pipeline.pattern.sequence import FrameSequence
from sim.boards import board_scene
from sim.boards.board_poses import BoardPose, middle, session_poses
from sim.render import render_pair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.printed_marks import Ink
from sim.scene.scene import Scene
from sim.scene.shapes import rectangle, sphere

# Even light from everywhere: the image is albedo and nothing else.
EVEN = Optics.ideal(psf_px=0.5, ambient=1.0)
TILTED = BoardPose((-25.0, 8.0, 30.0), (0.35, -0.6, 0.1))


def dark_image(layout):
    return np.zeros((*layout.projector_size[::-1], 3), np.uint8)


def albedo_seen(layout, board, pose, optics=EVEN):
    """Both images as a share of the paper's brightness."""
    rendered = board_scene.render_views(layout, board, [pose], optics, [dark_image(layout)])
    paper = 255 * board_scene.PAPER_ALBEDO
    gains = [optics.gain(camera) for camera in (0, 1)]
    return [counts.mean(axis=-1) / (paper * gain) for counts, gain in zip(rendered.counts[0][0], gains, strict=True)]


def moments(ink, outline):
    """Centroid and area of the ink inside an outline (n, 2)."""
    low, high = np.floor(outline.min(axis=0)).astype(int), np.ceil(outline.max(axis=0)).astype(int) + 1
    mask = np.zeros((high - low)[::-1], np.uint8)
    cv2.fillPoly(mask, [np.rint(outline - low).astype(np.int32)], 1)
    part = ink[low[1] : high[1], low[0] : high[0]] * mask
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    return np.array([(part * u).sum(), (part * v).sum()]) / part.sum(), part.sum()


@pytest.mark.parametrize("pose", [pytest.param(BoardPose(), marks=pytest.mark.long), TILTED])
def test_rendered_circles_have_the_centroids_and_areas_of_exact_projection(pose, quarter):
    rotation, place = pose.in_world(DEFAULT_BOARD, quarter)
    rig = quarter.calibration()
    angle = np.linspace(0, 2 * np.pi, 60)
    around = 13.5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    share = board_scene.INK_ALBEDO / board_scene.PAPER_ALBEDO
    for device, seen in zip((rig.left, rig.right), albedo_seen(quarter, DEFAULT_BOARD, pose), strict=True):
        expected, areas = board_scene.true_centroids(device, DEFAULT_BOARD, rotation, place)
        outlines = device.project((DEFAULT_BOARD.points[:, None] + around) @ rotation.T + place)
        found = [moments((1 - seen) / (1 - share), outline) for outline in outlines]
        away = np.array([centroid for centroid, _ in found]) - expected
        assert np.abs(away).max() < 0.005
        assert np.array([area for _, area in found]) == pytest.approx(areas, rel=2e-3)


def test_the_centroid_of_a_tilted_circle_is_not_the_image_of_its_centre(quarter):
    board, rig = DEFAULT_BOARD, quarter.calibration()
    rotation, place = TILTED.in_world(board, quarter)
    centroids, areas = board_scene.true_centroids(rig.left, board, rotation, place)
    away = np.linalg.norm(centroids - board_scene.true_marks(quarter, board, TILTED)["left"], axis=1)
    assert 0.01 < away.mean() < 0.1
    pinhole = replace(rig.left, distortion=np.zeros(5))
    # A conic's own algebra (Heikkila and Silven, 1997) agrees where there is no distortion.
    exact, exact_areas = board_scene.true_centroids(pinhole, board, rotation, place)
    for k in (0, 49, 98):
        to_image = pinhole.matrix @ np.stack([rotation[:, 0], rotation[:, 1], rotation @ board.points[k] + place], 1)
        conic = np.linalg.inv(to_image).T @ np.diag([1, 1, -(10.0**2)]) @ np.linalg.inv(to_image)
        assert exact[k] == pytest.approx(np.linalg.solve(conic[:2, :2], -conic[:2, 2]), abs=1e-8)
    assert exact_areas == pytest.approx(areas, rel=0.05)


@pytest.mark.parametrize(
    "text",
    [
        "circles:11x9:32:20",
        pytest.param("acircles:5x9:60", marks=pytest.mark.long),
        pytest.param("chessboard:9x6:34", marks=pytest.mark.long),
        pytest.param("charuco:10x7:32:23:DICT_4X4_100", marks=pytest.mark.long),
    ],
)
def test_images_of_boards_do_not_depend_on_the_number_of_rays(text):
    board, layout = parse_board(text), RigLayout().scaled(0.125)
    few, many = (albedo_seen(layout, board, TILTED, replace(EVEN, psf_px=0.7, supersampling=s))[0] for s in (4, 8))
    inner = cv2.erode((few > 0.01).astype(np.uint8), np.ones((5, 5))) > 0
    assert inner.sum() > 1000
    # Corners are sharp: where two of them meet, some thousandths remain.
    assert np.abs(few - many)[inner].max() < 0.02
    assert np.sqrt(np.mean((few - many)[inner] ** 2)) < 0.002
    assert few[inner].min() == pytest.approx(board_scene.INK_ALBEDO / board_scene.PAPER_ALBEDO, abs=0.03)
    assert few[inner].max() == pytest.approx(1, abs=0.01)


def test_inner_corners_of_a_chessboard_are_at_their_true_pixels(quarter):
    board = parse_board("chessboard:9x6:34")
    rig = quarter.calibration()
    truth = board_scene.true_marks(quarter, board, TILTED)
    for device, seen in zip((rig.left, rig.right), albedo_seen(quarter, board, TILTED), strict=True):
        start = truth[device.name].astype(np.float32)[:, None]
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        found = cv2.cornerSubPix(seen.astype(np.float32), start + np.float32(0.4), (4, 4), (-1, -1), stop)[:, 0]
        # What is left is the corner finder's own, a few hundredths of a pixel of either sign where edges are sharp.
        away = found - truth[device.name]
        assert np.abs(away).max() < 0.06
        assert np.abs(away.mean(axis=0)).max() < 0.01


def test_markers_are_read_as_what_they_are_and_not_mirrored(quarter):
    board = parse_board("charuco:10x7:32:23:DICT_4X4_100")
    facing = BoardPose((0.0, 0.0, 20.0), (0.1, -0.2, 0.05))
    seen, _ = albedo_seen(quarter, board, facing)
    image = np.clip(255 * seen, 0, 255).astype(np.uint8)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(charuco(board)).detectBoard(
        cv2.resize(image, None, fx=3, fy=3)
    )
    assert len(markers) > 25
    assert len(ids) > 40
    found = (corners.reshape(-1, 2) + 0.5) / 3 - 0.5
    assert np.abs(found - board_scene.true_marks(quarter, board, facing)["left"][ids.ravel()]).max() < 0.5


def test_the_back_of_a_board_is_white(small):
    seen, _ = albedo_seen(small, DEFAULT_BOARD, BoardPose((0.0, 0.0, 0.0), (0.0, np.pi, 0.0)))
    assert seen[30:70, 30:95].min() > 0.99


def test_the_stage_and_the_renderer_show_the_same_board(small):
    optics = board_scene.fine(Optics())
    image = small.pattern().image()
    rendered = board_scene.render_views(small, DEFAULT_BOARD, [TILTED], optics, [image])
    expected = render_pair.render_counts(small, board_scene.board_scene(DEFAULT_BOARD, TILTED), image, optics)
    for ours, theirs in zip(rendered.counts[0][0], expected, strict=True):
        assert np.abs(ours - theirs).max() < 0.05


def test_a_seed_is_a_noise_of_its_own(small):
    views = board_scene.render_views(small, DEFAULT_BOARD, [BoardPose(), TILTED])
    first, again, other = (views.images(seed, 1)[0][0] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    (left, _), (same, _) = views.images(1, 0)[0], views.images(1, 0)[0]
    assert np.array_equal(left, same)
    assert first.max() < 255


def test_a_sequence_is_shown_frame_by_frame_and_other_things_may_stand_beside(small):
    sequence = FrameSequence("any", (Uniform(small.projector_size, (0, 0, 0)), Fringe(small.projector_size, 12.0)))
    views = board_scene.render_views(small, DEFAULT_BOARD, [TILTED], frames=sequence)
    ((black, fringe),) = views.counts
    assert black[0].max() < 20 < fringe[0].max()
    hand = sphere(30).placed((0, 0, -60))
    hidden = board_scene.render_views(small, DEFAULT_BOARD, [TILTED], frames=sequence, beside=[hand]).counts[0][1]
    changed = np.abs(hidden[0] - fringe[0]).max(axis=-1) > 3
    assert 0.005 < changed.mean() < 0.2


def test_invalid_ink_is_rejected():
    with pytest.raises(ValueError, match=r"share is 1\.5"):
        Ink(np.zeros((0, 3)), np.zeros((0, 4)), 1.5)
    with pytest.raises(ValueError, match="discs"):
        Ink(np.zeros((2, 2)), np.zeros((0, 4)), 0.1)


def test_paper_without_ink_is_plain_paper(small):
    marks = Ink(np.zeros((0, 3)), np.array([[300.0, 300.0, 310.0, 310.0]]), 0.1)
    optics = Optics.ideal(ambient=0.1)
    plain, printed = (
        render_pair.render_counts(small, Scene("paper", (sheet.placed((5, 0, 0), turn=(0.2, 0.1, 0)),)),
                             small.pattern(), optics)[0]
        for sheet in (rectangle(200, 150), rectangle(200, 150, ink=marks))
    )  # fmt: skip
    assert np.array_equal(plain, printed)


def test_poses_of_a_session_are_those_of_a_good_one(quarter):
    assert session_poses(3, 3, quarter) == session_poses(3, 3, quarter) != session_poses(3, 4, quarter)
    poses = session_poses(12, 3, quarter)
    normals = np.array([pose.rotation[:, 2] for pose in poses])
    tilts = np.array([pose.tilt_deg for pose in poses])
    assert tilts[0] == 0
    assert 40 < tilts.max() <= 45.01
    # Tilted to all four sides.
    assert normals[:, 0].min() < -0.3 < 0.3 < normals[:, 0].max()
    assert normals[:, 1].min() < -0.3 < 0.3 < normals[:, 1].max()
    depths = np.array([pose.at_mm[2] for pose in poses])
    assert depths.min() < -0.4 * quarter.depth_mm / 2
    assert depths.max() > quarter.depth_mm / 2


@pytest.mark.parametrize(
    "text",
    [
        "circles:11x9:32:20",
        pytest.param("acircles:5x9:60", marks=pytest.mark.long),
        "charuco:10x7:32:23:DICT_4X4_100",
    ],
)
def test_every_mark_of_a_session_is_in_every_image(text, quarter):
    board, rig = parse_board(text), quarter.calibration()
    covered = np.zeros((4, 4), bool)
    for pose in session_poses(12, 1, quarter, board):
        truth = board_scene.true_marks(quarter, board, pose)
        for device in (rig.left, rig.right, rig.projector):
            pixels = truth[device.name]
            assert (pixels > 2).all()
            assert (pixels < np.array(device.size) - 3).all()
        cells = np.floor(4 * truth["left"] / quarter.camera_size).astype(int)
        covered[cells[:, 1], cells[:, 0]] = True
        rotation, place = pose.in_world(board, quarter)
        centre = rotation @ middle(board) + place
        stage_rotation, origin = quarter.stage_pose()
        assert (centre - origin) @ stage_rotation == pytest.approx(pose.at_mm)
    assert covered.all()


@pytest.mark.parametrize(("n", "tilt"), [(0, 45), (3, 80)])
def test_invalid_sessions_are_rejected(n, tilt):
    with pytest.raises(ValueError, match="session_poses"):
        session_poses(n, tilt_deg=tilt)


def test_a_board_that_never_fits_raises_an_error(quarter):
    with pytest.raises(ValueError, match="does not fit"):
        session_poses(2, 0, quarter, parse_board("circles:11x9:320"))
