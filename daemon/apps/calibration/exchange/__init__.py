"""Calibrations of other programs: OpenCV's FileStorage, Kalibr's camchain, ROS camera_info."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange import kalibr, opencv, ros
from daemon.apps.calibration.exchange.common import Imported, Named
from daemon.common.bounded import read_at_most
from pipeline.rig.calibration import Cameras

LIMIT = 4 << 20

_READERS: Mapping[str, Callable[..., Imported]] = {"opencv": opencv.read, "kalibr": kalibr.read, "ros": ros.read}
_WRITERS: Mapping[str, Callable[[Cameras], tuple[dict[str, bytes], list[str]]]] = {
    "opencv": opencv.write,
    "kalibr": kalibr.write,
    "ros": ros.write,
}
FORMATS = tuple(_READERS)


def read_foreign(
    paths: Sequence[Path], *, form: str = "", size: tuple[int, int] | None = None, unit_mm: float = 1.0
) -> Imported:
    """The cameras in files of another program.

    Args:
        paths: one file, or several that belong together (OpenCV's intrinsics and extrinsics; ROS's left and right).
        form: one of :data:`FORMATS`; told by the content if empty.
        size: (width, height) of both cameras where the files do not tell (OpenCV).
        unit_mm: length of the unit of an OpenCV translation, which is the unit of the board's description there.

    Raises:
        SourceError: it names the file and the key.
    """
    files = [Named(str(path), read_at_most(path, LIMIT, SourceError)) for path in paths]
    form = form or guessed(files[0])
    if form == "opencv":
        return opencv.read(files, size=size, unit_mm=unit_mm)
    return _READERS[_known(form)](files)


def write_foreign(cameras: Cameras, form: str) -> tuple[dict[str, bytes], list[str]]:
    """Files of another program by name, and what they cannot hold, in whole sentences."""
    return _WRITERS[_known(form)](cameras)


def guessed(file: Named) -> str:
    """The format of a file by its content."""
    text = file.data[:65536]
    if b"opencv-matrix" in text or text.startswith(b"%YAML:1.0") or b"<opencv_storage" in text:
        return "opencv"
    if b"cam0:" in text:
        return "kalibr"
    if b"camera_matrix" in text and b"image_width" in text:
        return "ros"
    raise SourceError(f"{file.name}: neither OpenCV, Kalibr nor ROS is recognised; give --format if it is one of them")


def _known(form: str) -> str:
    if form not in FORMATS:
        raise SourceError(f"format {form!r:.40}: expected one of {', '.join(FORMATS)}")
    return form
