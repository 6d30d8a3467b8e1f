"""Accuracy of a calibration: ``python -m benchmarks.calibration.accuracy``, on sessions of the simulated rig.

A session of board views is rendered once and read out with another noise for every seed. Every seed is calibrated from
its images alone; the errors are those against the rig that was rendered, and their scatter over the seeds must
agree with the reported standard deviations. The exit code is 1 when a promise is broken.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle import Solution, calibrate
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board, parse_board
from pipeline.calibrate.targets.find_marks import find_marks
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.rig.camera_model import CameraModel
from sim.boards.board_scene import RenderedViews, render_views, session_poses, true_centroids, true_marks
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics

Array = NDArray[np.float64]
SIDES = ("left", "right")

FOCAL_LIMIT, CENTRE_LIMIT_PX, LENS_LIMIT_PX, BASELINE_LIMIT = 3e-4, 0.3, 0.03, 2e-4
FLOOR_LIMIT, SIGMA_LIMIT = 1.15, 1.5
COMPARED = ("fx", "fy", "cx", "cy")


@dataclass(slots=True)
class Sessions:
    """Results of many sessions."""

    errors: dict[str, list[float]] = field(default_factory=dict)
    sigmas: dict[str, list[float]] = field(default_factory=dict)
    worst: dict[str, float] = field(default_factory=dict)
    rms_px: list[float] = field(default_factory=list)
    centre_bias_px: list[float] = field(default_factory=list)
    centroid_bias_px: list[float] = field(default_factory=list)
    marks: dict[tuple[int, str], list[Array]] = field(default_factory=dict)

    def note(self, name: str, value: float) -> None:
        """Keep the worst of a figure."""
        self.worst[name] = max(self.worst.get(name, 0.0), abs(value))

    def floor_px(self) -> float:
        """Scatter of the marks over the seeds, px, as in ``Solution.rms`` (both coordinates)."""
        variances = [np.stack(found).var(axis=0, ddof=1).sum(axis=-1).mean() for found in self.marks.values()]
        return float(np.sqrt(np.mean(variances)))

    def ratios(self) -> dict[str, float]:
        """Scatter of each parameter over the seeds, as a share of the reported standard deviation."""
        return {
            name: float(np.std(values, ddof=1) / np.mean(self.sigmas[name])) for name, values in self.errors.items()
        }


def marks_of(image: NDArray[Any], board: Board) -> Marks:
    """The marks of a board in one image, ordered by their numbers."""
    marks = find_marks(image, board).marks
    order = np.argsort(marks.ids)
    areas = None if marks.areas_px is None else marks.areas_px[order]
    return Marks(marks.ids[order], marks.pixels[order], marks.sigma_px[order], areas)


def lens_error_px(found: CameraModel, true: CameraModel) -> float:
    """Largest difference of the distortions within the image, px.

    A small rotation of the device is no error of its lens: the best rotation and focal length are removed first, as the
    pose of the device compensates for them.
    """
    width, height = true.size
    u, v = np.meshgrid(np.linspace(0, width - 1, 15), np.linspace(0, height - 1, 13))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = true.normalise(pixels)
    x, y = rays.T
    moved = found.to_pixels(found.distort(rays)) - pixels
    # Rotations about x, y and z move an image by these amounts, first order, and a focal length by (x, y).
    zero = np.zeros_like(x)
    columns = [
        np.stack([x * y, 1 + y * y], 1), np.stack([1 + x * x, x * y], 1), np.stack([-y, x], 1), np.stack([x, zero], 1),
        np.stack([zero, y], 1),
    ]  # fmt: skip
    design = np.stack([column.ravel() for column in columns], axis=1)
    rest = moved.ravel() - design @ np.linalg.lstsq(design, moved.ravel(), rcond=None)[0]
    return float(np.hypot(*rest.reshape(-1, 2).T).max())


def run(rendered: RenderedViews, seeds: range) -> Sessions:
    """Detect marks and calibrate, once a seed."""
    layout, board = rendered.layout, rendered.board
    true = layout.calibration()
    out = Sessions()
    for seed in seeds:
        views = []
        for k, pose in enumerate(rendered.poses):
            (pair,) = rendered.images(seed, k)
            found = {side: marks_of(image, board) for side, image in zip(SIDES, pair, strict=True)}
            views.append(BoardView(f"view {k}", found))
            _compare_marks(out, layout, board, pose, k, found)
        _compare(out, calibrate(board, views, dict.fromkeys(SIDES, layout.camera_size)), true.left, true.right)
        print(".", end="", flush=True)
    print()
    return out


def _compare_marks(
    out: Sessions, layout: RigLayout, board: Board, pose: object, view: int, found: dict[str, Marks]
) -> None:
    rotation, place = pose.in_world(board, layout)  # type: ignore[attr-defined]
    points, rig = true_marks(layout, board, pose), layout.calibration()  # type: ignore[arg-type]
    for side, marks in found.items():
        out.marks.setdefault((view, side), []).append(marks.pixels)
        out.centre_bias_px.append(float(np.hypot(*(marks.pixels - points[side][marks.ids]).T).mean()))
        if board.round:
            centroids, _ = true_centroids(getattr(rig, side), board, rotation, place)
            out.centroid_bias_px.append(float(np.hypot(*(marks.pixels - centroids[marks.ids]).T).mean()))


def _compare(out: Sessions, solution: Solution, *cameras: CameraModel) -> None:
    for true in cameras:
        found = solution.devices[true.name]
        for key, row, column in (("fx", 0, 0), ("fy", 1, 1), ("cx", 0, 2), ("cy", 1, 2)):
            name, error = f"{true.name}.{key}", float(found.matrix[row, column] - true.matrix[row, column])
            out.errors.setdefault(name, []).append(error)
            out.sigmas.setdefault(name, []).append(solution.sigma[name])
            if key.startswith("f"):
                out.note("focal length", error / true.matrix[row, column])
            else:
                out.note("principal point", error)
        out.note("lens within the image", lens_error_px(found, true))
    baseline = float(np.linalg.norm(cameras[1].centre - cameras[0].centre))
    out.errors.setdefault("baseline_mm", []).append(solution.baseline_mm - baseline)
    out.sigmas.setdefault("baseline_mm", []).append(solution.sigma["baseline_mm"])
    out.note("baseline", solution.baseline_mm / baseline - 1)
    out.rms_px.append(solution.rms_stereo)


def report(out: Sessions, seeds: int, views: int) -> bool:
    """Print the table; whether all promises are kept."""
    floor, rms = out.floor_px(), float(np.mean(out.rms_px))
    rows = [
        ("focal length", f"{100 * out.worst['focal length']:.4f} %", "0.03 %", out.worst["focal length"] < FOCAL_LIMIT),
        ("principal point", f"{out.worst['principal point']:.3f} px", "0.3 px",
         out.worst["principal point"] < CENTRE_LIMIT_PX),
        ("lens within the image", f"{out.worst['lens within the image']:.4f} px", "0.03 px",
         out.worst["lens within the image"] < LENS_LIMIT_PX),
        ("baseline", f"{100 * out.worst['baseline']:.4f} %", "0.02 %", out.worst["baseline"] < BASELINE_LIMIT),
        ("rms / noise floor", f"{rms:.4f} / {floor:.4f} px = {rms / floor:.3f}", f"{FLOOR_LIMIT}",
         rms < FLOOR_LIMIT * floor),
    ]  # fmt: skip
    ratios = out.ratios()
    rows += [
        (f"scatter / sigma, {name}", f"{ratio:.2f}", f"1/{SIGMA_LIMIT} to {SIGMA_LIMIT}",
         1 / SIGMA_LIMIT < ratio < SIGMA_LIMIT)
        for name, ratio in ratios.items()
    ]  # fmt: skip
    print(f"\nworst of {seeds} sessions of {views} views\n\n| figure | found | promised | |\n| --- | --- | --- | --- |")
    for name, value, limit, kept in rows:
        print(f"| {name} | {value} | {limit} | {'kept' if kept else 'MISSED'} |")
    if out.centroid_bias_px:
        print("\nmean distance of a detected mark from the image of the circle's centre "
              f"{np.mean(out.centre_bias_px):.4f} px, "
              f"from the centroid of the circle's image {np.mean(out.centroid_bias_px):.4f} px")  # fmt: skip
    return all(kept for *_, kept in rows)


def main(arguments: list[str] | None = None) -> int:
    """Render, calibrate, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--scale", type=float, default=1.0, help="1 = 1024 x 820")
    parser.add_argument("--board", type=parse_board, default=DEFAULT_BOARD)
    parser.add_argument("--poses", type=int, default=0, help="seed of the poses")
    chosen = parser.parse_args(arguments)
    layout = RigLayout().scaled(chosen.scale)
    poses = session_poses(chosen.views, chosen.poses, layout, chosen.board)
    rendered = render_views(layout, chosen.board, poses, Optics())
    out = run(rendered, range(chosen.sessions))
    return 0 if report(out, chosen.sessions, chosen.views) else 1


if __name__ == "__main__":
    sys.exit(main())
