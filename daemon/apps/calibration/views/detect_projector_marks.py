"""Detection of a board's marks in the projector's image, from the fringes around them."""

from __future__ import annotations

from collections.abc import Sequence

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.views.detect_marks import DetectedViews
from daemon.apps.calibration.views.view import Progress, Source, View, white_frame
from pipeline.calibrate.projector.absolute_phase import coordinates, levels
from pipeline.calibrate.projector.projector_marks import CameraObservation, projector_marks
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import ImageError, TargetError
from pipeline.pattern.sequence import FrameSequence

MOST_DENSE = 4
"""Views whose phases of all pixels are kept for the trinocular residual; 130 MB each at 1024 x 820 pixels."""


def detect_views_with_projector(sources: Sequence[Source], board: Board, progress: Progress) -> DetectedViews:
    """Detect the marks in all views, in the projector's image too where fringes ran in both directions.

    Raises:
        SourceError: no source has fringes in both directions; projectors of two sizes.
    """
    detected = DetectedViews()
    sequences = [source.sequence if has_fringes(source.sequence) else None for source in sources]
    if not any(sequences):
        raise SourceError(
            f"{', '.join(source.name for source in sources)}: no sequence with fringes in both directions, which "
            "the projector's calibration requires; capture with the sequence 'projector'"
        )
    for source, sequence in zip(sources, sequences, strict=True):
        if sequence is None:
            for view in source.views(progress, only=white_frame(source.sequence)):
                detected.add(view, 0, board)
        else:
            first = detected.sizes.setdefault("projector", sequence.size)
            if first != sequence.size:
                raise SourceError(
                    f"{source.name}: its projector has {sequence.size[0]} x {sequence.size[1]} pixels, that of the "
                    f"other views {first[0]} x {first[1]}"
                )
            for view in source.views(progress):
                add_with_fringes(detected, view, sequence, board)
        detected.left_out += source.left_out
    return detected


def has_fringes(sequence: FrameSequence | None) -> bool:
    """Whether a sequence encodes both coordinates of the projector."""
    return sequence is not None and bool(levels(sequence, "x")) and bool(levels(sequence, "y"))


def add_with_fringes(detected: DetectedViews, view: View, sequence: FrameSequence, board: Board) -> None:
    """Detect the marks of a view with all frames of a sequence, for both cameras and the projector."""
    detected.sizes.setdefault("projector", sequence.size)
    marks = detected.add(view, 0, board, sequence)
    if not marks:
        return
    name = detected.views[-1].name
    try:
        cameras = _camera_coordinates(marks, view, sequence)
        on_projector = projector_marks(board, cameras).marks
    except (TargetError, ImageError) as error:
        detected.left_out.append(f"{name}, projector: {error}")
        return
    detected.views[-1] = BoardView(name, {**marks, "projector": on_projector})
    if len(cameras) == 2 and len(detected.phases) < MOST_DENSE:
        left, right = cameras["left"], cameras["right"]
        detected.phases.append(((left.x, left.y), (right.x, right.y)))


def _camera_coordinates(marks: dict[str, Marks], view: View, sequence: FrameSequence) -> dict[str, CameraObservation]:
    cameras = {}
    for device, images in (("left", view.left), ("right", view.right)):
        if device in marks:
            x, y = coordinates(images, sequence, encoding=view.encoding)
            cameras[device] = CameraObservation(marks[device], x, y)
    return cameras
