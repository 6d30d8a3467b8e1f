"""Detection of disc candidates: regions that may be circles of a board, of any size, under uneven light.

On every level of a pyramid a pixel is compared with the middle of the darkest and brightest pixel around it. Such a
threshold follows shade and illumination, and it finds discs from about 4 pixels across to half of the window; the next
level finds discs twice as large. A region is a disc if its area is that of the ellipse of its moments.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.localise.gray_image import GrayPlane, image_noise

Array = NDArray[np.float64]

_WINDOW = 31
_LEAST_AREA = 7
_MOST_AXES_RATIO = 5.0
_FILLED = 0.78, 1.12
_LEAST_CONTRAST = 0.06
_NOISE_LIMIT = 5.0
_MOST = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Discs:
    """Candidates.

    Args:
        centres: (n, 2) u, v, pixels.
        shapes: (n, 2, 2) radius matrices E, pixels: the edge is at ``centre + E w`` for unit vectors w; symmetric.
        contrast: (n,) difference to the surrounding, in the units of the image, positive.
    """

    centres: Array
    shapes: Array
    contrast: Array

    def __len__(self) -> int:
        return len(self.centres)

    def some(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Discs:
        """Some of them."""
        return Discs(self.centres[chosen], self.shapes[chosen], self.contrast[chosen])

    @property
    def radii(self) -> Array:
        """(n,) geometric mean of the half axes, pixels."""
        return np.sqrt(np.abs(np.linalg.det(self.shapes)))


def find_discs(values: GrayPlane, *, dark: bool = True, first_level: int = 0) -> Discs:
    """All candidates of one polarity, strongest contrast first, none twice.

    Args:
        values: (H, W).
        dark: dark discs on a light ground; else light ones on a dark ground.
        first_level: levels below are skipped: discs under ``4 * 2**first_level`` pixels across are not detected.
    """
    level = values if dark else -values
    levels, scale = [], 1
    for index in range(12):
        if index >= first_level:
            levels.append(_on_level(level, scale))
        if min(level.shape) < 2 * _WINDOW:
            break
        level = np.asarray(cv2.resize(level, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.float32)
        scale *= 2
    return _distinct(levels)


def _on_level(values: GrayPlane, scale: int) -> Discs:
    smooth = cv2.GaussianBlur(values, (0, 0), 0.7)
    kernel = np.ones((_WINDOW, _WINDOW), np.uint8)
    low, high = float(smooth.min()), float(smooth.max())
    if high - low <= 0:
        return _none()
    # In 8 bit the running extremes are many times faster; the threshold does not need more.
    eight = np.asarray(np.round((smooth - low) * (255 / (high - low))), dtype=np.uint8)
    darkest, brightest = cv2.erode(eight, kernel), cv2.dilate(eight, kernel)
    limit = max(_LEAST_CONTRAST * 255, _NOISE_LIMIT * image_noise(values) * 255 / (high - low))
    middle = np.asarray(cv2.addWeighted(darkest, 0.5, brightest, 0.5, 0), dtype=np.uint8)
    inside = ((eight < middle) & (cv2.subtract(brightest, darkest) > limit)).astype(np.uint8)
    count, components, stats, _ = cv2.connectedComponentsWithStats(inside, connectivity=4)
    labels = np.asarray(components, dtype=np.int32)
    height, width = values.shape
    box = stats[:, :4]
    inside_image = (box[:, 0] > 0) & (box[:, 1] > 0)
    inside_image &= (box[:, 0] + box[:, 2] < width) & (box[:, 1] + box[:, 3] < height)
    area = stats[:, cv2.CC_STAT_AREA]
    chosen = inside_image & (area >= _LEAST_AREA) & (np.maximum(box[:, 2], box[:, 3]) <= 0.9 * _WINDOW)
    chosen &= area > 0.3 * box[:, 2] * box[:, 3]
    chosen[0] = False
    if not chosen.any():
        return _none()
    return _measured(eight, middle, labels, chosen, count, scale, (high - low) / 255)


def _measured(
    eight: NDArray[np.uint8],
    middle: NDArray[np.uint8],
    labels: NDArray[np.int32],
    chosen: NDArray[np.bool_],
    count: int,
    scale: int,
    unit: float,
) -> Discs:
    """Moments of the chosen components; those that are not filled ellipses are left out."""
    pixels = np.flatnonzero(chosen.take(labels.ravel()))
    label = labels.ravel()[pixels]
    v, u = np.divmod(pixels, labels.shape[1])
    depth = middle.ravel()[pixels].astype(np.float64) - eight.ravel()[pixels]

    def total(weight: Array | None) -> Array:
        return np.bincount(label, weight, count)[chosen].astype(np.float64)

    area, weight_sum = total(None), total(depth)
    centre = np.stack([total(depth * u), total(depth * v)], axis=1) / weight_sum[:, None]
    plain = np.stack([total(u.astype(np.float64)), total(v.astype(np.float64))], axis=1) / area[:, None]
    index = np.zeros(count, np.intp)
    index[chosen] = np.arange(chosen.sum())
    du, dv = u - plain[index[label], 0], v - plain[index[label], 1]
    second = np.empty((len(area), 2, 2))
    second[:, 0, 0], second[:, 1, 1] = total(du * du) / area + 1 / 12, total(dv * dv) / area + 1 / 12
    second[:, 0, 1] = second[:, 1, 0] = total(du * dv) / area
    spread, axes = np.linalg.eigh(second)
    filled = area / (4 * np.pi * np.sqrt(np.maximum(spread[:, 0] * spread[:, 1], 1e-12)))
    good = (filled > _FILLED[0]) & (filled < _FILLED[1])
    good &= spread[:, 1] < _MOST_AXES_RATIO**2 * spread[:, 0]
    # The centroid of the depth and that of the area agree in a disc with one even tone.
    good &= np.linalg.norm(centre - plain, axis=1) < 0.25 * np.sqrt(spread[:, 1]) + 0.3
    half = 2 * np.sqrt(spread) * np.sqrt(filled)[:, None]
    shapes = np.einsum("nij,nj,nkj->nik", axes, half, axes)
    contrast = 2 * weight_sum / area * unit
    return Discs(((centre + 0.5) * scale - 0.5)[good], shapes[good] * scale, contrast[good])


def _none() -> Discs:
    return Discs(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))


def merged(one: Discs, other: Discs) -> Discs:
    """The candidates of ``one``, and those of ``other`` that are not among them."""
    return _distinct([one, other])


def _distinct(levels: list[Discs]) -> Discs:
    """Candidates of all levels; of several with one centre only that of the first."""
    kept = levels[0] if levels else _none()
    for coarse in levels[1:]:
        if len(kept) and len(coarse):
            radii, kept_radii = coarse.radii, kept.radii
            distinct = np.empty(len(coarse), dtype=bool)
            for index, centre in enumerate(coarse.centres):
                apart = np.hypot(*(kept.centres - centre).T)
                distinct[index] = (apart > 0.5 * np.maximum(radii[index], kept_radii)).all()
            coarse = coarse.some(distinct)
        kept = Discs(*(np.concatenate([getattr(kept, k), getattr(coarse, k)]) for k in Discs.__slots__))
    order = np.argsort(-kept.contrast, kind="stable")[:_MOST]
    return kept.some(order)
