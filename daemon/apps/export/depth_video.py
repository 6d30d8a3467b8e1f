"""Videos of depth maps: near is warm, far is cold, invalid is black."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError, InputError

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}


def depth_image(depth_mm: NDArray[np.float32], near_mm: float, far_mm: float) -> NDArray[np.uint8]:
    """A depth map as a colour image, (H, W) -> (H, W, 3) B G R; depths outside the limits have the end colours."""
    valid = np.isfinite(depth_mm)
    share = (far_mm - np.where(valid, depth_mm, far_mm)) / (far_mm - near_mm)
    levels = np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)
    colors = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), dtype=np.uint8)
    colors[~valid] = 0
    return colors


def depth_limits(depths_mm: Iterable[NDArray[np.float32]]) -> tuple[float, float]:
    """The range of depths with nearly all points of all maps, mm."""
    ranges = [np.percentile(valid, (1, 99)) for depth in depths_mm if (valid := depth[np.isfinite(depth)]).size]
    if not ranges:
        raise DaemonError("the clouds contain no points, so the video would be empty")
    near, far = float(min(r[0] for r in ranges)), float(max(r[1] for r in ranges))
    margin = max(0.5, 0.02 * (far - near))
    return near - margin, far + margin


def write_video(path: Path, images: Iterable[NDArray[np.uint8]], *, rate_hz: float) -> int:
    """Write images of one size as a video and verify it.

    Args:
        path: ``.mp4`` or ``.avi``.
        images: (H, W, 3) B G R; odd sizes lose their last row or column, because the codecs require even sizes.

    Returns:
        Number of written images.

    Raises:
        DaemonError: an unknown format, images of different sizes, or an unreadable file.
    """
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(f"{path}: unknown video format, expected {' or '.join(CODECS)}")
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix.lower(), dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        count = _encode(temporary, path, codec, images, rate_hz)
        _check(temporary, path, count)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    return count


def _encode(temporary: Path, path: Path, codec: str, images: Iterable[NDArray[np.uint8]], rate_hz: float) -> int:
    writer: cv2.VideoWriter | None = None
    size, count = (0, 0), 0
    try:
        for image in images:
            even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
            if writer is None:
                size = (even.shape[1], even.shape[0])
                writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter_fourcc(*codec), rate_hz, size)  # type: ignore[attr-defined]
                if not writer.isOpened():
                    raise DaemonError(f"{path}: this OpenCV cannot write {codec} video of {size[0]} x {size[1]}")
            if (even.shape[1], even.shape[0]) != size:
                raise DaemonError(f"{path}: image {count} is {even.shape[1]} x {even.shape[0]}, the first {size}")
            writer.write(np.ascontiguousarray(even))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    if count == 0:
        raise DaemonError(f"{path}: no images for a video")
    return count


def _check(temporary: Path, path: Path, count: int) -> None:
    """Count the images of the written video, because OpenCV does not report a full disk."""
    video = cv2.VideoCapture(str(temporary))
    try:
        readable = 0
        while video.grab():
            readable += 1
    finally:
        video.release()
    if readable != count:
        raise DaemonError(f"{path}: {readable} of {count} images are readable; check the free disk space")
