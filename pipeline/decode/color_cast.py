"""Colour cast of an image: gains and fringe contrasts of the channels that most of its surfaces have in common.

Other light on top of the projector's, a white balance or surfaces of one colour make one channel brighter than another
everywhere. The phasor of a pixel then has a constant part that does not turn with the fringes, and noise, texture and
edges displace its phase more; where the channels' fringes have unequal contrast as well, it moves on an ellipse. The
same correction in both cameras changes their phases alike, which cancels in the match. Strongly coloured surfaces get
gains of their own, see :mod:`pipeline.decode.kernels.color_gains`, and do not count.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.decode.kernels.color_gains import MILD

F64 = NDArray[np.float64]

SMALL_GAIN, SMALL_CONTRAST, LARGEST = 0.05, 0.03, 2.5
"""Logarithms of the largest gain and contrast up to which nothing is corrected: neutral surfaces lose what coloured
ones win; gain from which it is a strong colour of most surfaces, and not a cast."""
_ROWS, _PERIODS, _DARK, _LIT, _PEAK = 40, 2, 8, 0.2, 245
"""Rows from one that is used to the next; fringe periods of a segment; counts of a dark one; standard deviation
over mean of one that shows fringes; counts of the fringes' maxima in one that is not saturated."""
_LEAST_SEGMENTS, _LEAST_SHARE, _ROUNDS = 50, 0.5, 3


class Cast(NamedTuple):
    """Gains (3,) of the channels, and contrasts (3,) of their fringes, relative to their means."""

    gains: F64
    contrasts: F64


NO_CAST = Cast(np.ones(3), np.ones(3))


def cast_of(
    image: NDArray[np.uint8], mosaic: NDArray[np.int64] | None, *, axis: str, period_px: float, black: Any, unmix: Any
) -> Cast:
    """The cast; :data:`NO_CAST` where most surfaces share no colour.

    Args:
        image: raw, (H, W, 3), or (H, W) of a mosaic; mosaic: (2, 2) channel numbers.
        axis: ``x`` = the phase grows along the rows; period_px: of the fringes.
        black: (3,) counts; unmix: (3, 3), from counts above black to those of the projector's channels.
    """
    samples, size, channels, kept = image[:, :, None], 1, np.arange(3)[None], np.ones(3)
    if mosaic is not None:
        height, width = (n // 2 for n in image.shape)
        samples = np.moveaxis(image[: 2 * height, : 2 * width].reshape(height, 2, width, 2), 1, 2)
        # The mean of both green samples, a pixel apart along the fringes, keeps a part of their contrast.
        size, channels, kept = 2, mosaic, np.array([1, np.cos(np.pi / period_px), 1])
    along = samples if axis == "x" else np.swapaxes(samples, 0, 1)
    rows = np.array(along[_ROWS // size // 2 :: _ROWS // size], order="C")  # a copy: one type for the kernel
    length = max(round(_PERIODS * period_px / size), 1)
    sums = np.zeros((len(rows), rows.shape[1] // length, 3, 4))
    _sum_segments(rows, np.array(channels), 1 / np.bincount(channels.ravel(), minlength=3), length, sums)
    means, products = sums[..., 3].reshape(-1, 3) / length, sums[..., :3].reshape(-1, 3, 3) / length
    back = np.asarray(unmix, np.float64)
    covariance = (products - means[:, :, None] * means[:, None]) / (kept[:, None] * kept)
    variance = ((back @ covariance) * back).sum(axis=2)
    colors = (means - black) @ back.T
    contrast = np.sqrt(np.maximum(variance, 0)) / np.maximum(colors, 1)
    peak = (means * (1 + 2**0.5 * contrast)).max(axis=1, initial=0)
    lit = (contrast.max(axis=1, initial=0) > _LIT) & (colors.min(axis=1, initial=np.inf) > _DARK)
    return _shared(colors[lit].T, contrast[lit & (peak < _PEAK)].T)


def _shared(colors: F64, contrasts: F64) -> Cast:
    """The cast of segments with colours (3, n) and contrasts (3, m)."""
    if colors.shape[1] < _LEAST_SEGMENTS:
        return NO_CAST
    colors = colors * (3 / colors.sum(axis=0))
    for near in (np.median(colors, axis=1), np.ones(3)):
        gains = _mean_near(colors, near)
        if gains.min() > 1 / LARGEST and gains.max() < LARGEST:
            relative = np.ones(3)
            if contrasts.shape[1] >= _LEAST_SEGMENTS:
                relative = np.median(contrasts / contrasts.mean(axis=0), axis=1)
            return Cast(_shrunk(gains, SMALL_GAIN), _shrunk(relative / relative.mean(), SMALL_CONTRAST))
    return NO_CAST


@serial
def _sum_segments(rows: Any, channels: Any, share: Any, length: int, sums: Any) -> None:
    """Sums (n, m, 3, 4) of the channels' products with each other, and of the channels, over segments of rows.

    Args:
        rows: (n, W, p, q) uint8, the samples of each pixel, or of each cell of a mosaic; channels: theirs, (p, q).
        share: (3,) one over the number of samples of each channel.
    """
    for i in range(sums.shape[0]):
        for k in range(sums.shape[1]):
            total = sums[i, k]
            for j in range(k * length, (k + 1) * length):
                red, green, blue = 0.0, 0.0, 0.0
                for a in range(rows.shape[2]):
                    for b in range(rows.shape[3]):
                        value, channel = np.float64(rows[i, j, a, b]), channels[a, b]
                        red += value if channel == 0 else 0.0
                        green += value if channel == 1 else 0.0
                        blue += value if channel == 2 else 0.0
                red, green, blue = red * share[0], green * share[1], blue * share[2]
                total[0, 0] += red * red
                total[1, 1] += green * green
                total[2, 2] += blue * blue
                total[0, 1] += red * green
                total[0, 2] += red * blue
                total[1, 2] += green * blue
                total[0, 3] += red
                total[1, 3] += green
                total[2, 3] += blue
            total[1, 0], total[2, 0], total[2, 1] = total[0, 1], total[0, 2], total[1, 2]


def _mean_near(colors: F64, gains: F64) -> F64:
    """Mean (3,) of the colours (3, n) that gains near some gains (3,) make mild ones; 0 if half of all are not."""
    for _ in range(_ROUNDS):
        mild = _strength(colors / gains[:, None]) < MILD
        if np.count_nonzero(mild) < _LEAST_SHARE * len(mild):
            return np.zeros(3)
        gains = colors[:, mild].mean(axis=1)
    return np.asarray(gains)


def _strength(color: F64) -> F64:
    """Vector sum of the channels (3, n) over half of their sum, (n,)."""
    x, y, z = color
    return np.asarray(2 * np.sqrt(np.maximum(x * x + y * y + z * z - x * y - y * z - z * x, 0)) / (x + y + z))


def _shrunk(values: F64, small: float) -> F64:
    """Values about 1 without what is small, so that a scene that changes a little changes them a little."""
    size = np.abs(np.log(np.maximum(values, 0.1))).max()
    return np.asarray(np.maximum(values, 0.1) ** max(1 - (small / max(size, small)) ** 2, 0.0))
