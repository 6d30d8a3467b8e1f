"""Image files of 8 or 16 bits, grey or RGB, read within limits."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_size import image_size
from daemon.common.files import read_at_most

Image = NDArray[Any]

FILE_LIMIT = 1 << 28
LEAST_SIDE, MOST_SIDE = 64, 16384
MOST_PIXELS = 1 << 27
MOST_IMAGES = 1000


def read_image(path: Path) -> Image:
    """Read a PNG, JPEG, TIFF or BMP file: (H, W) or (H, W, 3) red, green, blue, uint8 or uint16.

    Raises:
        SourceError: the file's name and its problem.
    """
    data = read_at_most(path, FILE_LIMIT, SourceError)
    if not data:
        raise SourceError(f"{path}: the file is empty")
    size = image_size(data)
    if size is None:
        raise SourceError(f"{path}: not a readable image; expected a PNG, JPEG, TIFF or BMP file")
    width, height = size
    if min(size) < LEAST_SIDE or max(size) > MOST_SIDE or width * height > MOST_PIXELS:
        raise SourceError(
            f"{path}: {width} x {height} pixels; expected {LEAST_SIDE} to {MOST_SIDE} on each side and at most "
            f"{MOST_PIXELS >> 20} million in total"
        )
    return _pixels(path, data, size)


def _pixels(path: Path, data: bytes, size: tuple[int, int]) -> Image:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.shape[1::-1] != size:
        raise SourceError(f"{path}: the image is damaged or truncated; copy or capture it again")
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError(f"{path}: pixels of type {image.dtype}; expected 8 or 16 bits")
    if image.ndim == 2:
        return image
    return np.ascontiguousarray(image[..., 2::-1])  # blue-green-red in OpenCV; a fourth channel is transparency


def matching_files(pattern: str, option: str) -> list[Path]:
    """Files matching_files a pattern such as ``L/*.png``, sorted by name; SourceError if there are none or too many."""
    paths = sorted(Path(name) for name in glob.glob(str(Path(pattern).expanduser()), recursive=True))  # noqa: PTH207
    paths = [path for path in paths if path.is_file()]
    if not paths:
        raise SourceError(f"{option} {pattern}: no file matches")
    if len(paths) > MOST_IMAGES:
        raise SourceError(f"{option} {pattern}: {len(paths)} files, at most {MOST_IMAGES} are read; name fewer")
    return paths


_DEMOSAIC = {
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
}


def demosaic(raw: Image, encoding: str) -> Image:
    """Convert a sensor's image to grey or RGB pixels; the quality suffices for the detection of marks."""
    code = _DEMOSAIC.get(encoding)
    if code is None:
        return raw
    if raw.dtype == np.float32:  # a mean of images; OpenCV demosaics only integers
        return np.asarray(cv2.cvtColor(np.clip(np.rint(raw * 256), 0, 65535).astype(np.uint16), code))
    return np.asarray(cv2.cvtColor(raw, code))


def as_raw(image: Image, encoding: str, name: str) -> Image:
    """Check that a file's pixels have the type of a raw image in ``encoding``; SourceError otherwise."""
    depth = np.uint16 if encoding == "mono16" else np.uint8
    dimensions = 3 if encoding == "rgb8" else 2
    if image.dtype != depth or image.ndim != dimensions:
        kind = "colour" if image.ndim == 3 else "grey"
        raise SourceError(f"{name}: {kind} image of {image.dtype}, but capture.json specifies {encoding}")
    return image
