"""Calibration files of other programs: OpenCV's FileStorage, Kalibr's camchain, ROS camera_info."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange import kalibr, opencv, ros
from daemon.apps.calibration.exchange.common import ImportedCameras, NamedFile
from daemon.common.files import read_at_most
from pipeline.rig.calibration import Cameras

LIMIT = 4 << 20

_READERS: Mapping[str, Callable[..., ImportedCameras]] = {"opencv": opencv.read, "kalibr": kalibr.read, "ros": ros.read}
_WRITERS: Mapping[str, Callable[[Cameras], tuple[dict[str, bytes], list[str]]]] = {
    "opencv": opencv.write,
    "kalibr": kalibr.write,
    "ros": ros.write,
}
FORMATS = tuple(_READERS)


def read_foreign(
    paths: Sequence[Path], *, form: str = "", size: tuple[int, int] | None = None, unit_mm: float = 1.0
) -> ImportedCameras:
    """Read the cameras in files of another program.

    Args:
        paths: one file, or several that belong together (OpenCV's intrinsics and extrinsics; ROS's left and right).
        form: one of :data:`FORMATS`; detected from the content if empty.
        size: (width, height) of both cameras, for files without it (OpenCV).
        unit_mm: length of the unit of an OpenCV translation, which is the unit of its board description.

    Raises:
        SourceError: the message names the file and the key.
    """
    files = [NamedFile(str(path), read_at_most(path, LIMIT, SourceError)) for path in paths]
    form = form or detect_format(files[0])
    if form == "opencv":
        return opencv.read(files, size=size, unit_mm=unit_mm)
    return _READERS[_checked(form)](files)


def write_foreign(cameras: Cameras, form: str) -> tuple[dict[str, bytes], list[str]]:
    """Files of another program by name, and notes about what the format cannot represent."""
    return _WRITERS[_checked(form)](cameras)


def detect_format(file: NamedFile) -> str:
    """The format of a file by its content."""
    text = file.data[:65536]
    if b"opencv-matrix" in text or text.startswith(b"%YAML:1.0") or b"<opencv_storage" in text:
        return "opencv"
    if b"cam0:" in text:
        return "kalibr"
    if b"camera_matrix" in text and b"image_width" in text:
        return "ros"
    raise SourceError(f"{file.name}: the format is not recognised as OpenCV, Kalibr or ROS; give --format")


def _checked(form: str) -> str:
    if form not in FORMATS:
        raise SourceError(f"format {form!r:.40}: expected one of {', '.join(FORMATS)}")
    return form
