"""From rendered images to projector marks: a nonlinear response, crosstalk, blur and noise, all unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibrate.projector.absolute_phase import Coordinate, coordinates
from pipeline.calibrate.projector.projector_marks import CameraObservation, projector_marks
from pipeline.calibrate.projector.trinocular_residual import moved, refine_projector, spread
from pipeline.calibrate.projector.trinocular_samples import samples_of_phases
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import Marks
from pipeline.pattern.sequence import projector_sequence
from pipeline.rig.calibration import Calibration
from sim.boards.board_scene import BoardPose, RenderedViews, render_views, true_centroids, true_marks
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from tests.pipeline.calibrate.projector.views import observation

pytestmark = pytest.mark.timeout(300)  # the renderer's kernels may have to be compiled

BOARD = Board("circles", 6, 5, 44.0, 26.0)
POSE = BoardPose((4.0, -3.0, 8.0), (0.35, -0.4, 0.08))
LAYOUT = RigLayout().scaled(0.375)
SEQUENCE = projector_sequence(LAYOUT.projector_size, finest_px=9.6)
MARK_PX = 0.01


@pytest.fixture(scope="module")
def view() -> RenderedViews:
    optics = Optics(gamma=2.2, precorrected=False, crosstalk=0.12)
    return render_views(LAYOUT, BOARD, [POSE], optics, [frame.image() for frame in SEQUENCE.frames])


def _phases(view: RenderedViews, side: int, seed: int) -> tuple[Coordinate, Coordinate]:
    images = [pair[side] for pair in view.images(seed, 0)]
    x, y = coordinates(images, SEQUENCE)
    return x, y


def _observation(view: RenderedViews, side: int, seed: int) -> CameraObservation:
    rig = LAYOUT.calibration()
    pixels, areas = true_centroids((rig.left, rig.right)[side], BOARD, *POSE.in_world(BOARD, LAYOUT))
    noise = MARK_PX * np.random.default_rng([seed, side]).standard_normal(pixels.shape)
    marks = Marks(np.arange(len(pixels)), pixels + noise, np.full(len(pixels), MARK_PX), areas)
    return CameraObservation(marks, *_phases(view, side, seed))


def test_errors_of_marks_agree_with_their_sigma(view: RenderedViews) -> None:
    got = projector_marks(BOARD, {"left": _observation(view, 0, 0), "right": _observation(view, 1, 0)})
    assert not len(got.rejected)
    assert len(got.marks) == len(BOARD.points)
    assert 0.6 < got.disagreement_px / got.expected_px < 1.5
    errors = got.marks.pixels - true_marks(LAYOUT, BOARD, POSE)["projector"][got.marks.ids]
    assert np.sqrt(np.square(errors).mean()) < 0.015
    assert 0.7 < np.std(errors / got.marks.sigma_px[:, None]) < 1.4


def test_a_board_under_a_sequence_corrects_a_disturbed_projector(view: RenderedViews) -> None:
    rig = LAYOUT.calibration()
    samples = samples_of_phases(rig, _phases(view, 0, 7), _phases(view, 1, 7), stride=3)
    assert spread(rig.projector, samples).systematic_px < 0.005
    disturbance = {"cx": 0.5, "rotation_y": np.deg2rad(0.01), "focal": 1e-4}
    got = refine_projector(Calibration(rig.left, rig.right, moved(rig.projector, disturbance)), samples)
    assert got.before.systematic_px > 0.3
    assert got.after.systematic_px < 0.005
    assert got.better


def test_matches_by_light_do_not_use_the_projector() -> None:
    rig = LAYOUT.calibration()
    both = {side: observation(LAYOUT, BOARD, POSE, side) for side in ("left", "right")}
    left, right = ((both[side].x, both[side].y) for side in ("left", "right"))
    wrong = replace(rig, projector=moved(rig.projector, {"cx": 3.0, "rotation_z": 0.01}))
    samples = samples_of_phases(wrong, left, right, stride=5)
    assert len(samples) > 1000
    rotation, place = POSE.in_world(BOARD, LAYOUT)
    heights = (samples.points - place) @ rotation[:, 2]
    assert np.median(np.abs(heights)) < 0.002
    assert np.quantile(np.abs(heights), 0.99) < 0.01
    nothing = replace(left[0], px=np.full_like(left[0].px, np.nan))
    assert not len(samples_of_phases(rig, (nothing, nothing), right))
    assert not len(samples_of_phases(rig, left, (nothing, nothing)))
