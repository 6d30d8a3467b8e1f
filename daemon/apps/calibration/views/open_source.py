"""Sources of views: image files named by a pattern, a capture folder, a take."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import MOST_IMAGES, Image, as_raw, matching_files, read_image
from daemon.apps.calibration.views.take_source import TakeSource
from daemon.apps.calibration.views.view import Progress, Source, View, described_sequence
from daemon.common.files import read_at_most
from daemon.rig.camera_serials import Serials
from drivers.protocols import SIDES
from pipeline.pattern.sequence import FrameSequence

CAPTURE = "capture.json"
_CAPTURE_LIMIT = 4 << 20
ENCODINGS = ("rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8", "mono8", "mono16")


class ImagePairs:
    """Images named by a pattern for each camera, sorted and paired by their order.

    Args:
        left, right: such as ``L/*.png``.

    Raises:
        SourceError: no files, or not as many for one camera as for the other.
    """

    sequence: FrameSequence | None = None

    def __init__(self, left: str, right: str) -> None:
        self.name = f"{left}, {right}"
        self.serials: Serials = {}
        self.left_out: list[str] = []
        self._left, self._right = matching_files(left, "--left"), matching_files(right, "--right")
        if len(self._left) != len(self._right):
            raise SourceError(
                f"--left {left} names {len(self._left)} images and --right {right} names {len(self._right)}: "
                "every view needs one of each camera"
            )
        same = set(self._left) & set(self._right)
        if same:
            raise SourceError(f"{min(same)}: named by both --left and --right; each camera has its own images")

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Yield every pair of files; ``only`` has no effect, a pair is one frame."""
        del only
        sizes = Sizes()
        for count, (left, right) in enumerate(zip(self._left, self._right, strict=True)):
            images = read_image(left), read_image(right)
            sizes.check("left", str(left), images[0])
            sizes.check("right", str(right), images[1])
            kind = "rgb8" if images[0].ndim == 3 else f"mono{8 * images[0].itemsize}"
            yield View(left.stem, (str(left), str(right)), (images[0],), (images[1],), kind)
            progress(count + 1, len(self._left))


class CaptureFolder:
    """A folder with ``capture.json`` and ``view_00/left_00.png`` ... for every frame of a sequence.

    Raises:
        SourceError: a missing file, or contents that contradict each other.
    """

    def __init__(self, folder: Path) -> None:
        self.name = str(folder)
        self.left_out: list[str] = []
        description = _object(folder / CAPTURE)
        encoding = description.get("encoding")
        if encoding not in ENCODINGS:
            raise SourceError(
                f"{folder / CAPTURE}: encoding is {encoding!r:.80}, expected one of {', '.join(ENCODINGS)}"
            )
        self._encoding = str(encoding)
        self.serials: Serials = _serials(description.get("serials", {}), folder / CAPTURE)
        self.sequence = described_sequence(description.get("sequence"), str(folder / CAPTURE))
        self._folders = sorted(path for path in folder.glob("view_*") if path.is_dir())
        if not self._folders:
            raise SourceError(f"{folder}: it contains no folder view_00 or any other view_*")
        if len(self._folders) > MOST_IMAGES:
            raise SourceError(f"{folder}: {len(self._folders)} views, at most {MOST_IMAGES} are read")

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Yield every view; raise SourceError for a missing frame."""
        sizes = Sizes()
        count = len(self.sequence) if self.sequence is not None else 1
        frames = range(count) if only is None else (only,)
        for number, folder in enumerate(self._folders):
            images: dict[str, tuple[Image, ...]] = {}
            for side in SIDES:
                paths = [folder / f"{side}_{frame:02d}.png" for frame in frames]
                images[side] = tuple(as_raw(read_image(path), self._encoding, str(path)) for path in paths)
                for path, image in zip(paths, images[side], strict=True):
                    sizes.check(side, str(path), image)
            files = tuple(str(folder / f"{side}_{frames[0]:02d}.png") for side in SIDES)
            yield View(folder.name, (files[0], files[1]), images["left"], images["right"], self._encoding)
            progress(number + 1, len(self._folders))


class Sizes:
    """Check that all images of a camera have one size."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[str, tuple[int, ...]]] = {}

    def check(self, side: str, name: str, image: Image) -> None:
        """Raise SourceError if an image differs in size from the first one of its camera."""
        first, shape = self._first.setdefault(side, (name, image.shape))
        if image.shape[:2] != shape[:2]:
            raise SourceError(
                f"{name}: {image.shape[1]} x {image.shape[0]} pixels, but {first} has {shape[1]} x {shape[0]}; "
                f"all images of the {side} camera must have one size"
            )


def open_source(path: Path) -> Source:
    """Open the capture folder or the take at a path."""
    if path.is_dir() and (path / CAPTURE).exists():
        return CaptureFolder(path)
    if path.is_dir() and not any(path.glob("*.mcap*")):
        raise SourceError(
            f"{path}: it contains neither {CAPTURE} with views nor a take; name plain images with --left and --right"
        )
    return TakeSource(path)


def _serials(value: Any, path: Path) -> Serials:
    known = isinstance(value, dict) and all(side in SIDES and isinstance(name, str) for side, name in value.items())
    if not known:
        raise SourceError(f"{path}: serials is {value!r:.80}, expected texts left and right")
    return dict(value)


def _object(path: Path) -> dict[str, Any]:
    data = read_at_most(path, _CAPTURE_LIMIT, SourceError)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{path}: not JSON: {error}") from error
    if not isinstance(value, dict):
        raise SourceError(f"{path}: expected a JSON object")
    return value
