"""Looks for the marks of a board on the projector's image: by the fringes that fall around them."""

from __future__ import annotations

from collections.abc import Sequence

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.views.detect_marks import Looked
from daemon.apps.calibration.views.view import Progress, Source, View, white_frame
from pipeline.calibrate.projector.absolute_phase import coordinates, levels
from pipeline.calibrate.projector.projector_marks import CameraObservation, projector_marks
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import ImageError, TargetError
from pipeline.pattern import sequence as sequences

MOST_DENSE = 4
"""Views whose phases of all pixels are kept for the trinocular residual; 130 MB each at 1024 x 820 pixels."""


def look_with_projector(sources: Sequence[Source], board: Board, progress: Progress) -> Looked:
    """Find the marks in all views, for the projector too where fringes were shown in both directions.

    Raises:
        SourceError: no source has fringes in both directions; projectors of two sizes.
    """
    looked = Looked()
    shown = [source.sequence if has_fringes(source.sequence) else None for source in sources]
    if not any(shown):
        raise SourceError(
            f"{', '.join(source.name for source in sources)}: no sequence with fringes in both directions, without "
            "them the projector cannot be found; capture with the sequence 'projector'"
        )
    for source, sequence in zip(sources, shown, strict=True):
        if sequence is None:
            for view in source.views(progress, only=white_frame(source.sequence)):
                looked.add(view, 0, board)
        else:
            known = looked.sizes.setdefault("projector", sequence.size)
            if known != sequence.size:
                raise SourceError(
                    f"{source.name}: made for a projector of {sequence.size[0]} x {sequence.size[1]} pixels, the views "
                    f"before for {known[0]} x {known[1]}"
                )
            for view in source.views(progress):
                add_with_fringes(looked, view, sequence, board)
        looked.left_out += source.left_out
    return looked


def has_fringes(sequence: sequences.FrameSequence | None) -> bool:
    """Whether a sequence tells both coordinates of the projector."""
    return sequence is not None and bool(levels(sequence, "x")) and bool(levels(sequence, "y"))


def add_with_fringes(looked: Looked, view: View, sequence: sequences.FrameSequence, board: Board) -> None:
    """Search a view of all frames of a sequence for both cameras and the projector."""
    looked.sizes.setdefault("projector", sequence.size)
    marks = looked.add(view, 0, board, sequence)
    if not marks:
        return
    name = looked.views[-1].name
    try:
        seen = _seen(marks, view, sequence)
        found = projector_marks(board, seen).marks
    except (TargetError, ImageError) as error:
        looked.left_out.append(f"{name}, projector: {error}")
        return
    looked.views[-1] = BoardView(name, {**marks, "projector": found})
    if len(seen) == 2 and len(looked.phases) < MOST_DENSE:
        left, right = seen["left"], seen["right"]
        looked.phases.append(((left.x, left.y), (right.x, right.y)))


def _seen(marks: dict[str, Marks], view: View, sequence: sequences.FrameSequence) -> dict[str, CameraObservation]:
    seen = {}
    for device, images in (("left", view.left), ("right", view.right)):
        if device in marks:
            x, y = coordinates(images, sequence, encoding=view.encoding)
            seen[device] = CameraObservation(marks[device], x, y)
    return seen
