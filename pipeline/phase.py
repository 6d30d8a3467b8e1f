"""Wrapped phase, modulation and mean of one picture.

Light in channel k is ``A + B cos(Phi + shift_k)``; the camera's channel c answers ``sum_k M_ck (...)``. With
C = B cos(Phi), S = B sin(Phi) every sample is linear in (A, C, S): ``I_c = a_c A + p_c C + q_c S``,
(a, p, q)_c = sum_k M_ck (1, cos shift_k, -sin shift_k). For shifts of 120 degrees and no crosstalk the solution is
``phi = atan2(sqrt(3) (R - B), 2 G - R - B)``.

A phasor ``C + i S`` is kept rather than its angle: it can be interpolated, the angle cannot.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import ColorModel
from pipeline.equalize import equalized_phasor, local_means
from pipeline.kernels import parallel, prange
from pipeline.noise import NoiseModel, estimate
from pipeline.settings import Settings
from pipeline.three_step import three_chip_pointwise
from pipeline.window_fit import fit_bayer, fit_three_chip, rough_channels, weights_of

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class PhaseMap:
    """Phase of one picture, all (H, W).

    Args:
        phasor: complex64, C + i S of the pointwise phase, counts; 0 where unknown.
        equalized: complex64, the same from channels divided by their local means; about unit size.
        mean: float32, A, counts: the fringe-free texture.
        variance: float32, variance of the pointwise phase from the picture's noise, rad^2.
        clipped: share of pixels with a clipped sample.
        phase, phase_eq: float32, wrapped angles of the two phasors.
        modulation: uint8, B, counts; valid: bool, B is enough and the fit had enough samples.
    """

    phasor: NDArray[np.complex64]
    equalized: NDArray[np.complex64]
    mean: F32
    variance: F32
    clipped: float
    phase: F32
    phase_eq: F32
    modulation: NDArray[np.uint8]
    valid: NDArray[np.bool_]

    def every(self, step: int) -> PhaseMap:
        """Every n-th pixel of every n-th row, copied."""
        planes = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "clipped"}
        return replace(self, **{name: np.ascontiguousarray(p[::step, ::step]) for name, p in planes.items()})


class Decoder:
    """Everything of a camera that can be computed once, and the decoding of its pictures.

    Args:
        color: black level and crosstalk.
        shifts: of the pattern's channels, radians.
        mosaic: (2, 2) channel numbers of a Bayer sensor, or None.
        slopes: expected phase steps per pixel in this camera's picture, (x, y) radians; one of them is 0.
    """

    def __init__(
        self,
        color: ColorModel,
        shifts: tuple[float, float, float],
        *,
        mosaic: NDArray[np.int64] | None,
        slopes: tuple[float, float],
        settings: Settings,
    ) -> None:
        self._rows = design(color, shifts)
        self._solve = np.linalg.inv(self._rows).astype(np.float32)
        self._ideal = np.linalg.inv(design(ColorModel(), shifts)).astype(np.float32)
        self._black = color.black.astype(np.float32)
        self._unmix = color.unmix.astype(np.float32)
        self._mosaic = mosaic
        self._axis = "x" if abs(slopes[0]) > abs(slopes[1]) else "y"
        self._period_px = 2 * np.pi / max(abs(slopes[0]), abs(slopes[1]))
        self._nominal = np.array([f(slope) for slope in slopes for f in (np.cos, np.sin)], dtype=np.float32)
        self._settings = settings
        self._weights = weights_of(*settings.window(mosaic=mosaic is not None))

    def decode(self, image: NDArray[np.uint8]) -> PhaseMap:
        """Phase of a raw picture, (H, W, 3) three-chip or (H, W) mosaic."""
        noise = self._noise(image)
        clip = np.float32(self._settings.saturation)
        if self._mosaic is None:
            phasor, mean, channels, tangential, clipped = three_chip_pointwise(
                image, self._solve, self._black, self._unmix, clip, np.float32(noise.floor), np.float32(noise.gain)
            )
            fitted = fit_three_chip(
                image, phasor, mean, tangential, clipped, self._rows, self._black, self._weights,
                self._nominal, clip, noise.floor, noise.gain,
            )  # fmt: skip
        else:
            channels, clipped = rough_channels(image, self._mosaic, self._black, self._unmix, clip)
            rough = _phasor_of(channels, self._ideal)
            fitted = fit_bayer(
                image, self._mosaic, rough, channels.mean(axis=2), self._rows, self._black, self._weights,
                self._nominal, clip, noise.floor, noise.gain,
            )  # fmt: skip
        means = local_means(channels, self._period_px, axis=self._axis)
        equalized = equalized_phasor(channels, means, self._ideal)
        modulation, valid = describe(fitted[0], fitted[2], np.float32(self._settings.min_modulation))
        share = float(np.count_nonzero(clipped)) / clipped.size
        return PhaseMap(
            fitted[0], equalized, fitted[1], fitted[2], share, angles(fitted[0]), angles(equalized), modulation, valid
        )

    def _noise(self, image: NDArray[np.uint8]) -> NoiseModel:
        if self._settings.read_noise > 0:
            return NoiseModel(self._settings.read_noise**2, self._settings.noise_gain)
        return estimate(image, along=0 if self._axis == "x" else 1, step=1 if self._mosaic is None else 2)


@parallel
def describe(phasor: Any, variance: Any, smallest: float) -> tuple[Any, Any]:
    """Modulation (H, W) uint8 and validity (H, W) bool."""
    height, width = phasor.shape
    modulation = np.empty((height, width), np.uint8)
    valid = np.empty((height, width), np.bool_)
    for i in prange(height):
        for j in range(width):
            p = phasor[i, j]
            size = sqrt(p.real * p.real + p.imag * p.imag)
            modulation[i, j] = np.uint8(size if size < 255.0 else 255.0)
            valid[i, j] = size >= smallest and variance[i, j] < np.float32(1.0)
    return modulation, valid


def angles(phasor: NDArray[np.complex64]) -> F32:
    """Wrapped phase of phasors; numpy's arctan2 uses vector instructions, a kernel's does not."""
    return np.asarray(np.arctan2(phasor.imag, phasor.real))


def _phasor_of(channels: F32, solve: F32) -> NDArray[np.complex64]:
    return np.asarray(channels @ (solve[1] + 1j * solve[2]).astype(np.complex64))


def design(color: ColorModel, shifts: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rows (a, p, q) of the three camera channels, (3, 3)."""
    delta = np.array(shifts)
    light = np.stack([np.ones(3), np.cos(delta), -np.sin(delta)], axis=1)
    return np.asarray(color.crosstalk @ light)
