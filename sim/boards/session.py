"""``python -m sim.boards DIR``: a calibration session of the simulated rig as images on disk, with the truth.

A capture folder holds ``capture.json`` (encoding, and the sequence that was shown) and ``view_00/left_00.png``,
``right_00.png``, ``left_01.png``, ...: one image a frame of the sequence. Beside it stand ``truth_calibration.json``
(the rig as it is), ``truth.json`` (for each view the board's pose in the world and the marks in each device's pixels),
``pattern.json`` and ``volume.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board, parse_board
from pipeline.common.errors import PipelineError
from pipeline.pattern.sequence import FrameSequence, camera_sequence, projector_sequence
from sim.boards.board_scene import BoardPose, board_scene, fine, session_poses, true_centroids, true_marks
from sim.render.projection_transport import Stage
from sim.render.render_pair import Image
from sim.render.sensor import ENCODINGS
from sim.rig import rig_files
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from sim.scene.scene import Scene


def write_capture(
    folder: Path,
    layout: RigLayout,
    sequence: FrameSequence,
    scenes: Sequence[Scene],
    optics: Optics,
    *,
    encoding: str = "rgb8",
    seed: int = 0,
) -> None:
    """Render each scene under each frame of a sequence and write a capture folder.

    Args:
        folder: created. scenes: one a view. seed: of the noise; the rest as in
            :func:`sim.render.render_pair.render_pair`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(folder / "capture.json", {"encoding": encoding, "sequence": sequence.as_mapping()})
    for view, scene in enumerate(scenes):
        place = folder / f"view_{view:02d}"
        place.mkdir(exist_ok=True)
        stage = Stage(layout, scene, optics, encoding=encoding)
        for k, frame in enumerate(sequence.frames):
            pair = stage.images(stage.counts(np.ascontiguousarray(frame.image())), noise_seed(seed, view, k))
            for side, image in zip(("left", "right"), pair, strict=True):
                write_image(place / f"{side}_{k:02d}.png", image)


def write_plain(
    folder: Path, layout: RigLayout, scenes: Sequence[Scene], optics: Optics, *, encoding: str = "rgb8", seed: int = 0
) -> None:
    """``left_00.png``, ``right_00.png``, ...: one image a scene under white light."""
    folder.mkdir(parents=True, exist_ok=True)
    (frame,) = camera_sequence(layout.projector_size).frames
    for view, scene in enumerate(scenes):
        stage = Stage(layout, scene, optics, encoding=encoding)
        pair = stage.images(stage.counts(frame.image()), noise_seed(seed, view, 0))
        for side, image in zip(("left", "right"), pair, strict=True):
            write_image(folder / f"{side}_{view:02d}.png", image)


def noise_seed(seed: int, view: int, frame: int) -> int:
    """Seed of the noise of one image of a session."""
    return 1_000_003 * seed + 1009 * view + frame


def write_image(path: Path, image: Image) -> None:
    """Write an image as PNG."""
    if not cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image):
        raise OSError(f"{path} cannot be written")


def write_truth(
    folder: Path, layout: RigLayout, optics: Optics, board: Board | None = None, poses: Sequence[BoardPose] = ()
) -> None:
    """Write the files of the true rig, and the true marks."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, mapping in (
        ("truth_calibration.json", rig_files.calibration_mapping(layout, optics)),
        ("pattern.json", rig_files.pattern_mapping(layout)),
        ("volume.json", rig_files.volume_mapping(layout)),
    ):
        _write_json(folder / name, mapping)
    if board is not None:
        views = [_true_view(layout, board, pose) for pose in poses]
        _write_json(folder / "truth.json", {"board": str(board), "views": views})


def _true_view(layout: RigLayout, board: Board, pose: BoardPose) -> dict[str, Any]:
    rotation, place = pose.in_world(board, layout)
    out: dict[str, Any] = {"rotation": rotation.tolist(), "translation": place.tolist(), "tilt_deg": pose.tilt_deg}
    out["points"] = {name: pixels.tolist() for name, pixels in true_marks(layout, board, pose).items()}
    if board.round:
        rig = layout.calibration()
        devices = rig.left, rig.right, rig.projector
        out["centroids"] = {d.name: true_centroids(d, board, rotation, place)[0].tolist() for d in devices}
    return out


def _write_json(path: Path, mapping: Any) -> None:
    path.write_text(json.dumps(mapping, indent=1))


def main(arguments: Sequence[str]) -> int:
    """Render and write the session, and print one line about it."""
    chosen = _parser().parse_intermixed_args(arguments)
    try:
        board = parse_board(chosen.board)
        # The rig's layout and optics check their own values.
        layout = RigLayout().scaled(chosen.scale)
        optics = fine(Optics(**dict(_setting(item) for item in chosen.optics)))
        poses = session_poses(chosen.views, chosen.seed, layout, board)
    except (PipelineError, ValueError, TypeError) as error:
        sys.stderr.write(f"sim.boards: {error}\n")
        return 2
    folder: Path = chosen.folder
    if chosen.color:
        _write_color(folder, layout, optics, chosen.encoding, chosen.seed)
        write_truth(folder, layout, optics)
        sys.stdout.write(f"{folder}: a white board under the colour sequence\n")
        return 0
    stage = [board_scene(board, pose) for pose in poses]
    if chosen.plain:
        write_plain(folder, layout, stage, optics, encoding=chosen.encoding, seed=chosen.seed)
    else:
        sequence = (projector_sequence if chosen.projector else camera_sequence)(layout.projector_size)
        write_capture(folder, layout, sequence, stage, optics, encoding=chosen.encoding, seed=chosen.seed)
    write_truth(folder, layout, optics, board, poses)
    tilt = max(pose.tilt_deg for pose in poses)
    sys.stdout.write(f"{folder}: {len(poses)} views of {board}, tilted by up to {tilt:.0f} degrees\n")
    return 0


def _write_color(folder: Path, layout: RigLayout, optics: Optics, encoding: str, seed: int) -> None:
    from pipeline.calibrate.color import color_sequence

    sequence = color_sequence(layout.projector_size, check=layout.pattern())
    write_capture(folder, layout, sequence, [build("plane")], optics, encoding=encoding, seed=seed)


def _setting(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"{text!r}: expected key=value, an option of the optics such as gamma=2.2")
    read = json.loads(value)
    return key, tuple(read) if isinstance(read, list) else read


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m sim.boards", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("optics", nargs="*", metavar="KEY=VALUE", help="of the optics, such as gamma=2.2 noise=0")
    parser.add_argument("--board", default=str(DEFAULT_BOARD), help="default: %(default)s")
    parser.add_argument("--views", type=int, default=12, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of poses and noise")
    parser.add_argument("--scale", type=float, default=0.5, help="of all images; 1 = 1024 x 820; default: %(default)s")
    parser.add_argument("--encoding", choices=ENCODINGS, default="rgb8")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--plain", action="store_true", help="left_00.png, right_00.png, ... under white light")
    what.add_argument("--projector", action="store_true", help="the sequence of fringes for the projector")
    what.add_argument("--color", action="store_true", help="the sequence of colours, on a white board without marks")
    return parser
