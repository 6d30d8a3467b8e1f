"""Raw images as planes of three colours, the even white area in them, and checks of the exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_sequence import Roles
from pipeline.common.errors import ImageError
from pipeline.decode.raw_image import mosaic_of

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

SATURATION = 254
MAX_SATURATED_SHARE = 0.01
LEAST_PEAK = 40.0
WHITE_SHARE = 0.55
LEAST_AREA = 0.01
_MARGIN_PX = 2


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """One camera's images of one sequence, in its order.

    Args:
        side: name of the camera, for errors.
        raw: (H, W, 3) for rgb8, (H, W) for a mosaic; uint8.
        encoding: see :mod:`pipeline.decode.raw_image`.
        names: what each frame shows, for errors.
    """

    side: str
    raw: Sequence[NDArray[np.uint8]]
    encoding: str
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        mosaic_of(self.encoding)
        deep = 3 if self.encoding == "rgb8" else 2
        for index, image in enumerate(self.raw):
            if image.dtype != np.uint8 or image.ndim != deep or image.shape != self.raw[0].shape:
                raise ImageError(
                    f"{self.side} camera, frame {index} ({self.names[index]}): {image.dtype} {image.shape} is no "
                    f"{self.encoding} image of the size of the first one, {self.raw[0].shape}; "
                    "images of colour are needed as the sensor gives them"
                )

    def planes(self, index: int) -> F32:
        """Counts of the three colours at every pixel, (H, W, 3)."""
        return planes_of(self.raw[index], self.encoding)

    def mean(self, indices: Sequence[int]) -> F32:
        """Mean of some frames, (H, W, 3)."""
        return np.asarray(sum(self.planes(i) for i in indices) / np.float32(len(indices)))

    def saturated(self, index: int, area: Mask) -> NDArray[np.float64]:
        """Share of the area's samples that are clipped, (3,) by colour."""
        full = self.raw[index] >= SATURATION
        if full.ndim == 3:
            return np.asarray(full[area].mean(axis=0))
        colors = _colors_of(full.shape, self.encoding)
        return np.array([full[area & (colors == k)].mean() for k in range(3)])

    def check_saturation(self, index: int, area: Mask) -> None:
        """ImageError when a colour of the area is clipped in this frame."""
        share = self.saturated(index, area)
        worst = int(share.argmax())
        if share[worst] > MAX_SATURATED_SHARE:
            raise ImageError(
                f"{self.side} camera, frame {index} ({self.names[index]}): {100 * share[worst]:.0f} % of the white "
                f"area are clipped in {('red', 'green', 'blue')[worst]} (limit {100 * MAX_SATURATED_SHARE:.0f} %); "
                "shorten the exposure or close the aperture, and take the sequence again"
            )


def planes_of(image: NDArray[np.uint8], encoding: str) -> F32:
    """Three colours at every pixel, (H, W, 3) float32 counts; a mosaic by symmetric means, which move no phase."""
    if encoding == "rgb8":
        return image.astype(np.float32)
    out = np.empty((*image.shape, 3), np.float32)
    for k, (own, share) in enumerate(_shares(image.shape[0], image.shape[1], encoding)):
        out[..., k] = _tent(own * image) * share
    return out


@lru_cache(maxsize=2)
def _shares(rows: int, columns: int, encoding: str) -> tuple[tuple[F32, F32], ...]:
    """For each colour its own pixels as ones, and the inverse weight of those around every pixel."""
    colors = _colors_of((rows, columns), encoding)
    own = [(colors == k).astype(np.float32) for k in range(3)]
    return tuple((mask, np.asarray(1 / _tent(mask))) for mask in own)


def _colors_of(shape: tuple[int, ...], encoding: str) -> NDArray[np.int64]:
    mosaic = mosaic_of(encoding)
    assert mosaic is not None  # noqa: S101 (callers require a mosaic)
    rows, columns = np.arange(shape[0]) & 1, np.arange(shape[1]) & 1
    return np.asarray(mosaic[rows[:, None], columns[None]])


def _tent(plane: F32) -> F32:
    """Weights 1 2 1 both ways; nothing beyond the border."""
    p = np.pad(plane, 1)
    rows = p[:-2] + 2 * p[1:-1] + p[2:]
    return np.asarray(rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:])


def white_area(images: Images, full: F32) -> Mask:
    """The evenly white part of the view, (H, W): where all three colours are strong, without marks and edges.

    Args:
        images: for errors; full: (H, W, 3), each colour's own full light, counts above the black frame.
    """
    top = np.percentile(full.reshape(-1, 3), 98, axis=0)
    for k, name in enumerate(("red", "green", "blue")):
        if top[k] < LEAST_PEAK:
            raise ImageError(
                f"{images.side} camera: full {name} light gives {top[k]:.0f} counts on the brightest part of the "
                f"view, expected at least {LEAST_PEAK:.0f}; lengthen the exposure, or put a white board into the light "
                "(are red and blue swapped, or is the projector dark?)"
            )
    bright = np.asarray((full > WHITE_SHARE * top).all(axis=2))
    area = eroded(bright, _MARGIN_PX)
    if area.mean() < LEAST_AREA:
        raise ImageError(
            f"{images.side} camera: only {100 * area.mean():.2g} % of the image are evenly white, expected at "
            f"least {100 * LEAST_AREA:.0f} %; put a matte white board into the projector's light"
        )
    return area


def eroded(mask: Mask, by: int) -> Mask:
    """A mask without the pixels nearer than ``by`` + 1 rows or columns to its outside."""
    p = np.pad(mask, by)
    rows, columns = mask.shape
    tall = np.logical_and.reduce([p[i : i + rows] for i in range(2 * by + 1)])
    return np.asarray(np.logical_and.reduce([tall[:, j : j + columns] for j in range(2 * by + 1)]))


def blocks(weights: Any, *planes: Any, side: int = 16) -> tuple[NDArray[np.float64], ...]:
    """Sums over square blocks of a weighted plane's pixels: of the weights, and of each plane times them; (n,) each."""
    rows, columns = weights.shape[0] // side * side, weights.shape[1] // side * side

    def summed(plane: Any) -> NDArray[np.float64]:
        cut = plane[:rows, :columns].reshape(rows // side, side, columns // side, side)
        return np.asarray(cut.sum(axis=(1, 3), dtype=np.complex128 if np.iscomplexobj(plane) else np.float64).ravel())

    return (summed(weights), *(summed(weights * plane) for plane in planes))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera's images of one pass with black frame, full light and white area.

    Args:
        black: (H, W, 3) mean of the black frames; full: (H, W, 3) each colour's own full light above it.
        area: (H, W) evenly white pixels.
    """

    images: Images
    black: F32
    full: F32
    area: Mask


def view_of(images: Images, roles: Roles) -> View:
    """Black frame, full light of each colour and white area of one pass; ImageError when it is clipped or dark."""
    black = images.mean(roles.black)
    own = [images.planes(roles.levels[k][-1][1])[..., k] - black[..., k] for k in range(3)]
    full = np.stack(own, axis=-1)
    area = white_area(images, full)
    for levels in roles.levels:
        images.check_saturation(levels[-1][1], area)
    return View(images, black, full, area)
