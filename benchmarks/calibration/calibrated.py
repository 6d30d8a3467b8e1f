"""Measuring with a rig's own calibration: ``python -m benchmarks.calibration.calibrated``, in simulation.

Colours, cameras and projector of a rendered rig (12 % crosstalk, gamma 2.2, noise) are calibrated from its images
alone; then scenes are measured with that calibration and with the true one. The world of a calibration is its
left camera, so clouds are aligned with the truth by the best rigid motion (no scale) before their error is computed.
The exit code is 1 when a promise is broken.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration.accuracy import SIDES, marks_of
from pipeline.calibrate.bundle import calibrate
from pipeline.calibrate.color import PhaseError, calibrate_color, check_sequence, color_sequence, phase_error
from pipeline.calibrate.color.solution import ColorSolution
from pipeline.calibrate.projector.absolute_phase import coordinate
from pipeline.calibrate.projector.projector_marks import CameraObservation, projector_marks
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.sequence import FrameSequence, projector_sequence
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from sim.boards.board_scene import board_scene, fine, session_poses
from sim.evaluate.score import AlignedScore, aligned
from sim.render.projection_transport import Stage
from sim.render.render_pair import render_images, truths
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

SCENES = "plane", "spheres", "face"
ERROR_LIMIT, PHASE_LIMIT = 1.3, 8.0
Pair = tuple[NDArray[Any], NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Rig:
    """The rendered rig; its calibration uses only its images."""

    layout: RigLayout
    optics: Optics
    seed: int = 0

    def pairs(self, stage: Stage, sequence: FrameSequence, calibration: ColorSolution | None, seed: int) -> list[Pair]:
        """Both cameras' images of every frame, shown through the inverse of the known response."""
        response = None if calibration is None else calibration.response
        return [
            stage.images(stage.counts(np.ascontiguousarray(frame.image(response))), 1_000 * (self.seed + seed) + k)
            for k, frame in enumerate(sequence.frames)
        ]


def colors(rig: Rig, geometry: Calibration | None = None) -> ColorSolution:
    """Colours from an even white board."""
    sequence = color_sequence(rig.layout.projector_size)
    stage = Stage(rig.layout, build("plane"), rig.optics)
    return calibrate_color(rig.pairs(stage, sequence, None, 1), sequence, calibration=geometry)


def view_of(
    rig: Rig, board: Board, pose: object, sequence: FrameSequence, color: ColorSolution, number: int
) -> BoardView:
    """One pose of the board: marks in both cameras and on the projector's image."""
    stage = Stage(rig.layout, board_scene(board, pose), fine(rig.optics))  # type: ignore[arg-type]
    pairs = rig.pairs(stage, sequence, color, 100 + number)
    observations = {}
    for k, side in enumerate(SIDES):
        images = [pair[k] for pair in pairs]
        x, y = (coordinate(images, sequence, axis) for axis in ("x", "y"))
        observations[side] = CameraObservation(marks_of(images[0], board), x, y)
    marks = {side: one.marks for side, one in observations.items()}
    return BoardView(f"view {number}", marks | {"projector": projector_marks(board, observations).marks})


def geometry(rig: Rig, board: Board, views: int, color: ColorSolution) -> tuple[Calibration, dict[str, float]]:
    """Cameras and projector in one adjustment."""
    layout = rig.layout
    sequence = projector_sequence(layout.projector_size)
    found = []
    for number, pose in enumerate(session_poses(views, rig.seed, layout, board)):
        found.append(view_of(rig, board, pose, sequence, color, number))
        print(".", end="", flush=True)
    print()
    sizes = dict.fromkeys(SIDES, layout.camera_size) | {"projector": layout.projector_size}
    solution = calibrate(board, found, sizes)
    devices = solution.devices
    calibrated = Calibration(devices["left"], devices["right"], devices["projector"])
    return calibrated, {name: float(value) for name, value in solution.quality().items()}


def measured(rig: Rig, calibration: Calibration, pattern: ColorFringe, scene: str) -> AlignedScore:
    """A scene under the pattern predistorted by this calibration, and the error of its cloud."""
    image = pattern.image(calibration.response)
    what = build(scene)
    left, right = render_images(rig.layout, what, image, rig.optics, 0.0, 77 + rig.seed)
    truth, _ = truths(rig.layout, what, pattern)
    cloud = Reconstructor(calibration, pattern, rig.layout.volume()).reconstruct(left, right)
    return aligned(cloud.xyz, truth)


def phase_errors(rig: Rig, color: ColorSolution) -> dict[str, tuple[PhaseError, PhaseError]]:
    """Before and after, by camera, on a fresh pattern."""
    sequence = check_sequence(replace(rig.layout.pattern(), periods=rig.layout.periods / 2))
    stage = Stage(rig.layout, build("plane"), rig.optics)
    before, after = rig.pairs(stage, sequence, None, 500), rig.pairs(stage, sequence, color, 600)
    models = {"left": color.left, "right": color.right}
    return {
        side: (
            phase_error([pair[k] for pair in before], sequence, side=side),
            phase_error([pair[k] for pair in after], sequence, color=models[side], side=side),
        )
        for k, side in enumerate(SIDES)
    }


def main(arguments: list[str] | None = None) -> int:
    """Calibrate, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="1 = 1024 x 820")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    # The calibration predistorts the images; the renderer sends them unchanged.
    optics = Optics(crosstalk=0.12, gamma=2.2, precorrected=False)
    rig = Rig(RigLayout().scaled(chosen.scale), optics, chosen.seed)
    started = time.monotonic()
    color = colors(rig)
    calibrated, quality = geometry(rig, DEFAULT_BOARD, chosen.views, color)
    color = colors(rig, calibrated)
    calibrated = color.applied(calibrated)
    print(f"calibrated in {time.monotonic() - started:.0f} s of rendering and solving: {quality}")
    for line in color.recommendations:
        print(line)
    kept = _report_phases(phase_errors(rig, color))
    true = rig.layout.calibration_for(optics)
    _report_devices(true, calibrated)
    return 0 if _report_scenes(rig, true, calibrated) and kept else 1


def _report_phases(errors: dict[str, tuple[PhaseError, PhaseError]]) -> bool:
    print("\n| camera | phase error before, rad | after, systematic | times smaller |\n| --- | --- | --- | --- |")
    kept = True
    for side, (before, after) in errors.items():
        ratio = before.systematic_rad / after.systematic_rad
        kept &= ratio >= PHASE_LIMIT
        print(f"| {side} | {before.systematic_rad:.4f} | {after.systematic_rad:.4f} (rms with noise "
              f"{after.rms_rad:.4f}) | {ratio:.1f} (promised {PHASE_LIMIT:g}) |")  # fmt: skip
    return kept


def _report_devices(true: Calibration, calibrated: Calibration) -> None:
    print("\n| device | focal length | principal point | distance to the left camera |\n| --- | --- | --- | --- |")
    for name in ("left", "right", "projector"):
        a: CameraModel = getattr(true, name)
        b: CameraModel = getattr(calibrated, name)
        centre = np.hypot(*(b.matrix[:2, 2] - a.matrix[:2, 2]))
        far = np.linalg.norm(b.centre) - np.linalg.norm(a.centre)
        print(f"| {name} | {100 * (b.matrix[0, 0] / a.matrix[0, 0] - 1):+.4f} % | {centre:.3f} px | {far:+.3f} mm |")


def _report_scenes(rig: Rig, true: Calibration, calibrated: Calibration) -> bool:
    pattern = rig.layout.pattern()
    print("\n| scene | calibration | within 1 mm | wrong | rms mm | smooth rms mm | ratio |\n" + "| --- " * 7 + "|")
    kept = True
    for scene in SCENES:
        best, own = (measured(rig, calibration, pattern, scene) for calibration in (true, calibrated))
        ratio = own.score.rms_mm / best.score.rms_mm
        kept &= ratio <= ERROR_LIMIT
        for name, found, times in (("true", best, ""), ("own", own, f"{ratio:.3f} (promised {ERROR_LIMIT})")):
            s = found.score
            print(f"| {scene} | {name} | {s.reconstructed:.2%} | {s.wrong:.3%} | {s.rms_mm:.4f} | "
                  f"{s.smooth_rms_mm:.4f} | {times} |")  # fmt: skip
    return kept


if __name__ == "__main__":
    sys.exit(main())
