"""The sensor: blur, colours, mosaic, noise and saturation of the light that reaches it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.rig.optics import Optics

Light = NDArray[np.float32]

# Channel (R G B = 0 1 2) of the four pixels of a cell: (0, 0), (0, 1), (1, 0), (1, 1).
MOSAICS = {
    "bayer_rggb8": (0, 1, 1, 2),
    "bayer_bggr8": (2, 1, 1, 0),
    "bayer_grbg8": (1, 0, 2, 1),
    "bayer_gbrg8": (1, 2, 0, 1),
}
ENCODINGS = ("rgb8", *MOSAICS, "mono8", "mono16")


def blurred(light: Light, optics: Optics) -> Light:
    """Light per pixel, (H, W, 3), of light per ray, (H s, W s, 3): lens blur, lateral colour, mean over each pixel."""
    s = optics.supersampling
    if optics.psf_px > 0:
        blur = cv2.GaussianBlur(light, (0, 0), optics.psf_px * s, borderType=cv2.BORDER_REPLICATE)
        light = np.asarray(blur, dtype=np.float32)
    if optics.chromatic != 0:
        light = _stretched(light, optics.chromatic)
    if s == 1:
        return light
    rows, columns = light.shape[0] // s, light.shape[1] // s
    return np.asarray(light.reshape(rows, s, columns, s, 3).mean(axis=(1, 3), dtype=np.float32))


def _stretched(light: Light, chromatic: float) -> Light:
    """Red magnified by 1 - chromatic and blue by 1 + chromatic about the image's centre."""
    rows, columns = light.shape[:2]
    out = light.copy()
    for channel, scale in ((0, 1 - chromatic), (2, 1 + chromatic)):
        back = np.array([[1 / scale, 0, (columns - 1) / 2 * (1 - 1 / scale)], [0, 1 / scale, 0]])
        back[1, 2] = (rows - 1) / 2 * (1 - 1 / scale)
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        plane = np.ascontiguousarray(light[..., channel])
        out[..., channel] = cv2.warpAffine(plane, back, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return out


def exposed(
    light: Light, camera: int, optics: Optics, encoding: str, crosstalk: NDArray[np.float64] | None = None
) -> Light:
    """Counts above black without noise: (H, W, 3) for colour chips, (H, W) for mosaic and mono.

    ``crosstalk`` (3, 3) replaces that of the optics, without a change of the gain.
    """
    crosstalk = optics.true_crosstalk()[camera] if crosstalk is None else crosstalk
    mix = (optics.gain(camera) * crosstalk).astype(np.float32)
    counts = light @ mix.T
    if encoding == "rgb8":
        return np.asarray(counts)
    if encoding.startswith("mono"):
        return np.asarray(counts.mean(axis=-1))
    if encoding not in MOSAICS:
        raise ValueError(f"encoding {encoding!r} is not known; there are {', '.join(ENCODINGS)}")
    return mosaic(counts, encoding)


def mosaic(image: Light, encoding: str) -> Light:
    """The mosaic of a colour image, (H, W, 3) -> (H, W)."""
    out = np.empty(image.shape[:2], image.dtype)
    for cell, channel in enumerate(MOSAICS[encoding]):
        row, column = divmod(cell, 2)
        out[row::2, column::2] = image[row::2, column::2, channel]
    return out


def noise_variance(counts: Light, optics: Optics) -> Light:
    """Variance in counts squared of pixels with these counts above black."""
    electron_dn = 255.0 / optics.full_well_e if optics.full_well_e > 0 else 0.0
    return np.asarray(
        optics.noise**2 * (np.maximum(counts, 0) * np.float32(electron_dn) + np.float32(optics.read_noise_dn**2))
    )


def read_out(
    counts: Light, optics: Optics, rng: np.random.Generator, encoding: str
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The sensor's image of counts above black: noise, black level, saturation, rounding."""
    if optics.noise > 0:
        noise = rng.standard_normal(counts.shape, dtype=np.float32)
        counts = counts + noise * np.sqrt(noise_variance(counts, optics))
    counts = counts + np.float32(optics.black_dn)
    if encoding == "mono16":
        return np.rint(np.clip(counts, 0, 255) * 257).astype(np.uint16)
    return np.rint(np.clip(counts, 0, 255)).astype(np.uint8)
