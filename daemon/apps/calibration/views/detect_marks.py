"""Looks for the marks in every image of a source; what cannot be used is remembered with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import cv2
import numpy as np

from daemon.apps.calibration.images.image_files import Image, unpacked
from daemon.apps.calibration.views.view import Progress, Source, View, white_frame
from pipeline.calibrate.projector.absolute_phase import Coordinate, evenly_lit
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect.detection_errors import edge_sigma_px, too_blurred
from pipeline.calibrate.targets.find_marks import Detection, find_marks
from pipeline.calibrate.targets.localise.gray_image import to_gray
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import TargetError
from pipeline.pattern.sequence import FrameSequence

THUMBNAIL_PX = 520
BLURRED_PX = 4.0
"""Sigma of an image's strongest edges from where on nothing else is said about it."""
_JPEG_QUALITY = 72

Phases: TypeAlias = tuple[Coordinate, Coordinate]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One image after the search.

    Args:
        view: its name; device: ``left`` or ``right``; file: what errors call it.
        size: (width, height), pixels.
        thumbnail: small JPEG of it, for the report.
        found: the marks and how sharp they are; None where they were not found, with the reason in ``problem``.
    """

    view: str
    device: str
    file: str
    size: tuple[int, int]
    thumbnail: bytes
    found: Detection | None = None
    problem: str = ""


@dataclass(slots=True)
class Looked:
    """All images of one or several sources.

    Args:
        views: those with marks in at least one image, in order; seen: all images; sizes: by device.
        left_out: views that the source could not give whole.
        phases: some views' projector coordinates (x, y) of all pixels, left and right.
    """

    views: list[BoardView] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    phases: list[tuple[Phases, Phases]] = field(default_factory=list)

    @property
    def problems(self) -> list[Seen]:
        """Images in which the marks were not found."""
        return [seen for seen in self.seen if seen.found is None]

    def add(self, view: View, frame: int, board: Board, sequence: FrameSequence | None = None) -> dict[str, Marks]:
        """Search both images of a view; the marks of those where they were found.

        Args:
            view: with all its frames, or the one that is looked at.
            frame: number of the image to look at.
            sequence: of fringes; their mean is looked at instead, which has less noise than one white image.
        """
        marks: dict[str, Marks] = {}
        name = self._free_name(view.name)
        for device, file, images in zip(("left", "right"), view.files, (view.left, view.right), strict=True):
            if not images:
                continue
            raw = images[frame] if sequence is None else evenly_lit(images, sequence)
            image = unpacked(raw, view.encoding)
            size = (image.shape[1], image.shape[0])
            known = self.sizes.setdefault(device, size)
            if known != size:
                raise TargetError(
                    f"{file}: {size[0]} x {size[1]} pixels, but the {device} images before have {known[0]} x {known[1]}"
                )
            found, problem = _found(image, board)
            if found is not None:
                marks[device] = found.marks
            self.seen.append(Seen(name, device, file, size, thumbnail(image), found, problem))
        if marks:
            self.views.append(BoardView(name, marks))
        return marks

    def _free_name(self, name: str) -> str:
        taken = {seen.view for seen in self.seen}
        return next(n for n in (name, *(f"{name} ({k})" for k in range(2, 10_000))) if n not in taken)


def look(sources: Sequence[Source], board: Board, progress: Progress) -> Looked:
    """Find the marks in all views of all sources, on the brightest even image of each view.

    Raises:
        SourceError: images that cannot be read. What can be read but not used is in :attr:`Looked.problems`.
    """
    looked = Looked()
    for source in sources:
        for view in source.views(progress, only=white_frame(source.sequence)):
            looked.add(view, 0, board)
        looked.left_out += source.left_out
    return looked


def require(looked: Looked, least: int) -> None:
    """TargetError unless marks were found in ``least`` views; it names the first images and their reasons."""
    if len(looked.views) >= least:
        return
    problems = looked.problems
    if not problems:
        count = len(looked.views)
        raise TargetError(
            f"{count} view{'' if count == 1 else 's'} of the board, at least {least} are needed: add views, tilted by "
            "20 to 40 degrees about both axes"
        )
    first = problems[0]
    more = f" The marks were found in {len(looked.seen) - len(problems)} of {len(looked.seen)} images."
    others = [seen for seen in problems[1:] if seen.problem != first.problem][:2]
    also = "".join(f" {seen.file}: {seen.problem}." for seen in others)
    raise TargetError(f"{first.file}: {first.problem}.{also}{more}")


def thumbnail(image: Image) -> bytes:
    """A small JPEG of an image, at most 520 pixels wide."""
    grey = image[..., ::-1] if image.ndim == 3 else image
    if grey.dtype != np.uint8:
        most = float(np.quantile(grey, 0.999)) if grey.dtype == np.uint16 else 255.0
        grey = np.clip(grey * (255.0 / max(most, 1.0)), 0, 255).astype(np.uint8)
    shrink = THUMBNAIL_PX / grey.shape[1]
    small: Any = grey
    if shrink < 1:
        size = (THUMBNAIL_PX, max(1, round(grey.shape[0] * shrink)))
        small = cv2.resize(np.ascontiguousarray(grey), size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(small), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return bytes(data) if done else b""


def _found(image: Image, board: Board) -> tuple[Detection | None, str]:
    try:
        return find_marks(image, board), ""
    except TargetError as error:
        # In an image out of focus some marks melt together, and what is found then is misleading.
        sigma = edge_sigma_px(to_gray(image))
        if sigma > BLURRED_PX and "saturated" not in str(error):
            error = too_blurred(sigma, BLURRED_PX)
        return None, str(error).rstrip(".")
