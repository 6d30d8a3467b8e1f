"""Detection of the marks in every image of the sources; an unusable image is kept with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import cv2
import numpy as np

from daemon.apps.calibration.images.image_files import Image, demosaic
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
"""Sigma of an image's strongest edges beyond which blur is the reported problem."""
_JPEG_QUALITY = 72

Phases: TypeAlias = tuple[Coordinate, Coordinate]


@dataclass(frozen=True, slots=True, eq=False)
class ImageDetection:
    """The result of the detection in one image.

    Args:
        view: name of the view; device: ``left`` or ``right``; file: name in messages.
        size: (width, height), pixels.
        thumbnail: small JPEG, for the report.
        detection: marks and sharpness; None if no marks were detected, with the reason in ``problem``.
    """

    view: str
    device: str
    file: str
    size: tuple[int, int]
    thumbnail: bytes
    detection: Detection | None = None
    problem: str = ""


@dataclass(slots=True)
class DetectedViews:
    """The marks detected in all images of one or several sources.

    Args:
        views: those with marks in at least one image, in order; images: all of them; sizes: by device.
        left_out: incomplete views.
        phases: projector coordinates (x, y) of all pixels, left and right, of some views.
    """

    views: list[BoardView] = field(default_factory=list)
    images: list[ImageDetection] = field(default_factory=list)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    phases: list[tuple[Phases, Phases]] = field(default_factory=list)

    @property
    def problems(self) -> list[ImageDetection]:
        """Images without detected marks."""
        return [image for image in self.images if image.detection is None]

    def add(self, view: View, frame: int, board: Board, sequence: FrameSequence | None = None) -> dict[str, Marks]:
        """Detect the marks in both images of a view and return them by device.

        Args:
            view: with all its frames, or with the one that is used.
            frame: number of the frame that is used.
            sequence: of fringes; their mean is used instead of ``frame``, it has less noise than one white image.
        """
        marks: dict[str, Marks] = {}
        name = self._free_name(view.name)
        for device, file, images in zip(("left", "right"), view.files, (view.left, view.right), strict=True):
            if not images:
                continue
            raw = images[frame] if sequence is None else evenly_lit(images, sequence)
            image = demosaic(raw, view.encoding)
            size = (image.shape[1], image.shape[0])
            first = self.sizes.setdefault(device, size)
            if first != size:
                raise TargetError(
                    f"{file}: {size[0]} x {size[1]} pixels, but the first {device} image has {first[0]} x {first[1]}"
                )
            detection, problem = _detect(image, board)
            if detection is not None:
                marks[device] = detection.marks
            self.images.append(ImageDetection(name, device, file, size, thumbnail(image), detection, problem))
        if marks:
            self.views.append(BoardView(name, marks))
        return marks

    def _free_name(self, name: str) -> str:
        used = {image.view for image in self.images}
        return next(n for n in (name, *(f"{name} ({k})" for k in range(2, 10_000))) if n not in used)


def detect_views(sources: Sequence[Source], board: Board, progress: Progress) -> DetectedViews:
    """Detect the marks in all views of all sources, on the brightest uniform frame of each view.

    Raises:
        SourceError: an unreadable image. Readable images without marks are in :attr:`DetectedViews.problems`.
    """
    detected = DetectedViews()
    for source in sources:
        for view in source.views(progress, only=white_frame(source.sequence)):
            detected.add(view, 0, board)
        detected.left_out += source.left_out
    return detected


def require_views(detected: DetectedViews, least: int) -> None:
    """Raise TargetError unless marks were detected in ``least`` views; it names the first images and their reasons."""
    if len(detected.views) >= least:
        return
    problems = detected.problems
    if not problems:
        count = len(detected.views)
        raise TargetError(
            f"{count} view{'' if count == 1 else 's'} of the board, at least {least} are required: add views with the "
            "board tilted by 20 to 40 degrees about both axes"
        )
    first = problems[0]
    total = len(detected.images)
    others = [image for image in problems[1:] if image.problem != first.problem][:2]
    also = "".join(f" {image.file}: {image.problem}." for image in others)
    raise TargetError(
        f"{first.file}: {first.problem}.{also} Marks were detected in {total - len(problems)} of {total} images."
    )


def thumbnail(image: Image) -> bytes:
    """Encode an image as a JPEG at most 520 pixels wide."""
    grey = image[..., ::-1] if image.ndim == 3 else image
    if grey.dtype != np.uint8:
        most = float(np.quantile(grey, 0.999)) if grey.dtype == np.uint16 else 255.0
        grey = np.clip(grey * (255.0 / max(most, 1.0)), 0, 255).astype(np.uint8)
    shrink = THUMBNAIL_PX / grey.shape[1]
    small: Any = grey
    if shrink < 1:
        size = (THUMBNAIL_PX, max(1, round(grey.shape[0] * shrink)))
        small = cv2.resize(np.ascontiguousarray(grey), size, interpolation=cv2.INTER_AREA)
    encoded, data = cv2.imencode(".jpg", np.ascontiguousarray(small), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return bytes(data) if encoded else b""


def _detect(image: Image, board: Board) -> tuple[Detection | None, str]:
    try:
        return find_marks(image, board), ""
    except TargetError as error:
        # In an image out of focus some marks merge, and the detector's own message is misleading.
        sigma = edge_sigma_px(to_gray(image))
        if sigma > BLURRED_PX and "saturated" not in str(error):
            error = too_blurred(sigma, BLURRED_PX)
        return None, str(error).rstrip(".")
