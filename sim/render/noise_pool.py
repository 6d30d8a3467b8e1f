"""Noise for many images a second: a pool of random numbers, read from another start for each image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.render.sensor import Light, noise_variance
from sim.rig.optics import Optics
from sim.scene.jit import compiled

Image = NDArray[np.uint8] | NDArray[np.uint16]
_STARTS = 1 << 20


class NoisePool:
    """Standard normal numbers for images of one size.

    Two images have the same noise once in two million; its distribution is that of :func:`sim.render.sensor.read_out`.

    Args:
        values: number of values in an image.
        seed: of the pool.
    """

    def __init__(self, values: int, seed: int) -> None:
        rng = np.random.default_rng([seed, 77])
        self._noise = rng.standard_normal(values + _STARTS, dtype=np.float32)
        self._seed = seed

    def image(self, counts: Light, deviation: Light, optics: Optics, encoding: str, *, index: int) -> Image:
        """The sensor's image, read-only.

        Args:
            counts: above black, without noise; deviation: their :func:`deviation_of`.
            index: number of the image, which determines its noise.
        """
        start, sign = np.random.default_rng([self._seed, index]).integers([_STARTS, 2])
        wide = encoding == "mono16"
        out = np.empty(counts.shape, np.uint16 if wide else np.uint8)
        _read_out(
            counts.ravel(), deviation.ravel(), self._noise[start:], np.float32(1 - 2 * sign),
            np.float32(optics.black_dn), np.float32(257 if wide else 1), out.reshape(-1),
        )  # fmt: skip
        out.setflags(write=False)
        return out


def deviation_of(counts: Light, optics: Optics) -> Light:
    """Standard deviation of the noise of each pixel, counts."""
    return np.sqrt(noise_variance(counts, optics))


@compiled
def _read_out(
    counts: Light,
    deviation: Light,
    noise: Light,
    sign: np.float32,
    black: np.float32,
    scale: np.float32,
    out: Image,
) -> None:
    for k in range(len(counts)):
        value = counts[k] + sign * noise[k] * deviation[k] + black
        out[k] = np.rint(min(max(value, np.float32(0)), np.float32(255)) * scale)
