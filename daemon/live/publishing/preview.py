"""``preview``: both images as JPEG, and the left one's modulation with saturated pixels marked."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.live.items import CloudItem
from daemon.live.publishing.messages import Frames, Origin
from drivers.protocols import Frame
from fringed import wire

_QUALITY = 80
_MARK_BGR = (0, 0, 255)
_GAIN = 2  # modulation is seldom over half of the range
_BAYER = {
    "bayer_rggb8": cv2.COLOR_BayerRGGB2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2BGR,
}

Image = NDArray[np.uint8]


def preview(origin: Origin, item: CloudItem) -> Frames:
    """Parts ``left``, ``right`` and ``overlay``, each the bytes of a JPEG file."""
    height, width = item.left.image.shape[:2]
    images = {"left": displayed(item.left), "right": displayed(item.right), "overlay": overlay(item)}
    header = wire.Header(
        kind="preview", seq=item.seq, t_ns=item.t_ns, data={"width": width, "height": height}, **origin.keys()
    )
    rows = {name: {"media": "image/jpeg"} for name in images}
    return wire.encode("preview", header, {name: _jpeg(p) for name, p in images.items()}, rows=rows)


def displayed(frame: Frame) -> Image:
    """The image for display, a mosaic interpolated: (H, W) or (H, W, 3) uint8, BGR."""
    image: NDArray[Any] = frame.image
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if frame.encoding in _BAYER:
        return np.asarray(cv2.cvtColor(image, _BAYER[frame.encoding]), np.uint8)
    return np.asarray(image[..., ::-1] if image.ndim == 3 else image, np.uint8)


def overlay(item: CloudItem) -> Image:
    """Modulation of the left image as brightness, saturated pixels red; (H, W, 3) uint8, BGR."""
    image: NDArray[Any] = item.left.image
    bright = np.minimum(item.measured.modulation[0], 255 // _GAIN) * np.uint8(_GAIN)
    if bright.shape != image.shape[:2]:  # measured with fewer pixels
        bright = bright.repeat(item.stride, axis=0).repeat(item.stride, axis=1)[: image.shape[0], : image.shape[1]]
    out = np.repeat(bright[..., None], 3, axis=2)
    saturated = image >= np.iinfo(image.dtype).max
    out[saturated.any(axis=2) if image.ndim == 3 else saturated] = _MARK_BGR
    return out


def _jpeg(image: Image) -> Image:
    good, data = cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not good:
        raise ValueError(f"OpenCV cannot encode an image of shape {image.shape}")
    return np.asarray(data, np.uint8).reshape(-1)
