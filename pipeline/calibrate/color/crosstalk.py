"""Crosstalk, balance and black level of a camera.

Crosstalk: in fringes of one colour, ``M_ck = B_c(k) / B_k(k)`` with B the amplitude that channel c shows of colour k.
Ambient light and black drop out. A response that is not corrected distorts the fringe, but the light of both channels
is the same, so the ratio is not affected. It is the part of channel c's phasor in phase with channel k's, block by
block; the result is the median over the board with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_planes import F32, Images, Mask, blocks
from pipeline.calibrate.color.color_sequence import FringeSet, Roles
from pipeline.common.errors import ImageError

Array = NDArray[np.float64]

LEAST_AMPLITUDE = 10.0
_NAMES = ("red", "green", "blue")
_DARK_SHARE = 0.3


def fringe_phasors(images: Images, fringes: FringeSet, channels: Sequence[int]) -> NDArray[np.complex64]:
    """Complex amplitude of some camera channels, (H, W, len(channels)): B e^{i phase}, counts.

    Least squares over the steps, which need not be even.
    """
    shifts = np.array(fringes.shifts)
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    solution = np.linalg.pinv(design)
    weights = (solution[1] + 1j * solution[2]).astype(np.complex64)
    out: Any = 0
    for index, weight in zip(fringes.indices, weights, strict=True):
        out = out + weight * images.planes(index)[..., list(channels)]
    return np.asarray(out, np.complex64)


@dataclass(frozen=True, slots=True, eq=False)
class MixSamples:
    """Ratios by blocks of the board: for each projector channel k (n_k, 3), signals of the camera's channels."""

    ratios: tuple[Array, Array, Array]


Triplet: TypeAlias = tuple[FringeSet, FringeSet, FringeSet]


def mix_samples(images: Images, fringes: Sequence[Triplet], area: Mask) -> MixSamples:
    """Signals of the three channels in fringes of each colour alone, relative to the colour's own channel."""
    out: list[list[Array]] = [[], [], []]
    for sets in fringes:
        for k, fringe in enumerate(sets):
            for index in fringe.indices:
                images.check_saturation(index, area)
            phasors = fringe_phasors(images, fringe, (0, 1, 2))
            own = phasors[..., k]
            power = np.abs(own) ** 2
            amplitude = float(np.sqrt(np.median(power[area])))
            if amplitude < LEAST_AMPLITUDE:
                raise ImageError(
                    f"{images.side} camera: fringes of {_NAMES[k]} have an amplitude of {amplitude:.1f} counts, "
                    f"expected at least {LEAST_AMPLITUDE:.0f}; focus the projector on the board or lengthen the "
                    "exposure"
                )
            total, *parts = blocks(
                area.astype(np.float32), power, *((phasors[..., c] * own.conj()).real for c in range(3))
            )
            good = total > 0.5 * total.max()
            out[k].append(np.stack([part[good] / parts[0][good] for part in parts[1:]], axis=1))
    return MixSamples((np.concatenate(out[0]), np.concatenate(out[1]), np.concatenate(out[2])))


def crosstalk_of(samples: Sequence[MixSamples], side: str) -> tuple[Array, Array, Array]:
    """(crosstalk, standard deviation of its entries, scatter over the board), each (3, 3)."""
    mix, sigma, scatter = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(3):
        values = np.concatenate([s.ratios[k] for s in samples])
        mix[:, k] = np.median(values, axis=0)
        scatter[:, k] = 1.4826 * np.median(np.abs(values - mix[:, k]), axis=0)
        # The median's variance is pi/2 times the mean's.
        sigma[:, k] = 1.2533 * scatter[:, k] / np.sqrt(len(values))
        strongest = int(np.abs(mix[:, k]).argmax())
        if strongest != k and abs(mix[strongest, k]) > 1.1:
            raise ImageError(
                f"{side} camera: {_NAMES[k]} light is strongest in the channel named {_NAMES[strongest]} "
                f"({mix[strongest, k]:.2f} times {_NAMES[k]}): the colours of camera or projector are swapped; "
                "check the encoding (RGB or BGR, the mosaic's first row)"
            )
    np.fill_diagonal(mix, 1.0)
    return mix, sigma, scatter


def balance_of(full: F32, area: Mask) -> Array:
    """Signals of the channels in their own full light on the white area, relative to their mean, (3,)."""
    own = full[area].mean(axis=0, dtype=np.float64)
    return np.asarray(own / own.mean())


def black_from_marks(black: F32, full: F32, area: Mask) -> Array | None:
    """Camera black from the dark marks inside the white area, (3,) counts; None where there are none.

    Ambient light and the projector's own black come back from a surface in proportion to its albedo, as its full light
    does: the counts of the black frame over those of full light are a straight line whose value at albedo 0 is the
    camera's black. The marks of a board (albedo some 0.05) hold its lower end.
    """
    strength = full.sum(axis=2)
    top = float(np.median(strength[area]))
    dark = _enclosed(area) & (strength < _DARK_SHARE * top)
    if np.count_nonzero(dark) < 200:
        return None
    low, high = strength[dark].mean(dtype=np.float64), strength[area].mean(dtype=np.float64)
    at_low, at_high = black[dark].mean(axis=0, dtype=np.float64), black[area].mean(axis=0, dtype=np.float64)
    slope = (at_high - at_low) / (high - low)
    return np.asarray(np.maximum(at_low - slope * low, 0.0))


def _enclosed(area: Mask) -> Mask:
    """Pixels with white area to the left, to the right, above and below them."""
    sides = [
        np.logical_or.accumulate(area, axis=1),
        np.logical_or.accumulate(area[:, ::-1], axis=1)[:, ::-1],
        np.logical_or.accumulate(area, axis=0),
        np.logical_or.accumulate(area[::-1], axis=0)[::-1],
    ]
    return np.asarray(np.logical_and.reduce(sides))


def black_level(
    images: Images, roles: Roles, black: F32, full: F32, area: Mask, *,
    dark: Sequence[NDArray[np.uint8]] | None, known: Array | None,
) -> tuple[Array, str]:  # fmt: skip
    """Camera black, (3,) counts, and its source: "lens cap", "marks", "known" or "darkest"."""
    if dark:
        capped = Images(images.side, dark, images.encoding, ("lens cap",) * len(dark))
        mean = capped.mean(range(len(dark)))
        level = mean.reshape(-1, 3).mean(axis=0, dtype=np.float64)
        usual = black[area].mean(axis=0, dtype=np.float64)
        if (level > usual + 1.0).any():
            raise ImageError(
                f"{images.side} camera: the images with the lens covered are brighter ({level.max():.1f} counts) "
                f"than those of the dark projector ({usual.max():.1f}); cover the lens and take them again"
            )
        return level, "lens cap"
    from_marks = black_from_marks(black, full, area)
    if from_marks is not None:
        return from_marks, "marks"
    if known is not None:
        return np.asarray(known, np.float64), "known"
    # The darkest part is at least as bright as the black, which suffices for the phase, see
    # docs/reference/calibration-file.md.
    index = roles.black[0]
    rows, columns = (n // 8 * 8 for n in black.shape[:2])
    small = images.planes(index)[:rows, :columns].reshape(rows // 8, 8, columns // 8, 8, 3).mean(axis=(1, 3))
    return np.asarray(small.reshape(-1, 3).min(axis=0), np.float64), "darkest"
