"""Wrapped phase, modulation and mean of one image.

Light in channel k is ``A + B cos(Phi + shift_k)``; the camera's channel c answers ``sum_k M_ck (...)``. With
C = B cos(Phi), S = B sin(Phi) every sample is linear in (A, C, S): ``I_c = a_c A + p_c C + q_c S``,
(a, p, q)_c = sum_k M_ck (1, cos shift_k, -sin shift_k). For shifts of 120 degrees and no crosstalk the solution is
``phi = atan2(sqrt(3) (R - B), 2 G - R - B)``.

A phasor ``C + i S`` is kept rather than its angle: it can be interpolated, the angle cannot.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.decode.chromatic_phase import ChromaticCorrection, chromatic_correction
from pipeline.decode.color_cast import NO_CAST, Cast, cast_of
from pipeline.decode.kernels.color_gains import limits_of
from pipeline.decode.kernels.color_texture import BANDS as COLOR_BANDS
from pipeline.decode.kernels.color_texture import color_texture, rough_colors
from pipeline.decode.kernels.decode_bayer import decode_bayer
from pipeline.decode.kernels.decode_rgb import BANDS, decode_rgb
from pipeline.decode.kernels.local_mean import BoxMean
from pipeline.decode.kernels.mosaic_fit import EIGHTHS
from pipeline.decode.kernels.window_fit import weights_of
from pipeline.decode.noise_model import NoiseModel, estimate
from pipeline.decode.pixel_descriptor import (
    EVEN,
    correct_descriptors,
    corrected_mean,
    correction_table,
    normalised_phase,
)
from pipeline.decode.raw_image import read_only
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration, ColorModel

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class PhaseMap:
    """Phase of one image, all (H, W).

    Decoding the next image overwrites all planes but the mean and the modulation.

    Args:
        phasor: int32, C + i S of the pointwise phase, see :mod:`pipeline.decode.packed_phasor`; 0 where invalid.
        descriptors: int32, see :mod:`pipeline.decode.pixel_descriptor`; they hold the normalised phase too, that of
            channels divided by their local means.
        variance: float32, variance of the pointwise phase from the image's noise, rad^2.
        saturated: share of pixels with a saturated sample.
        phase: float32, wrapped angle of the pointwise phasor.
        mean, modulation: uint8, A (the fringe-free texture) and B, counts.
        valid: bool, B is enough and the fit had enough samples.
        brightness: uint8, counts, mean of the channels made equally bright by their local means, of the pixel alone.
    """

    phasor: NDArray[np.int32]
    descriptors: NDArray[np.int32]
    mean: NDArray[np.uint8]
    variance: F32
    saturated: float
    phase: F32
    modulation: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    brightness: NDArray[np.uint8]

    @property
    def phase_normalised(self) -> F32:
        """Normalised phase, computed at every call."""
        return normalised_phase(self.descriptors)

    def subsampled(self, stride: int) -> PhaseMap:
        """Every n-th pixel of every n-th row, copied."""
        planes: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "saturated"}
        for name, plane in planes.items():
            planes[name] = np.ascontiguousarray(plane[::stride, ::stride])
        return replace(self, **planes)

    def with_corrected_mean(self) -> PhaseMap:
        """With the mean that the descriptors hold, see :meth:`Decoder.correct`, as its mean."""
        return replace(self, mean=corrected_mean(self.descriptors))

    def displaced(self, pixels: int, axis: int) -> PhaseMap:
        """With the descriptors of the pixels that are so much farther along an axis, 0 beyond the border."""
        descriptors = np.roll(self.descriptors, -pixels, axis)
        beyond = slice(-pixels, None) if pixels > 0 else slice(0, -pixels)
        np.moveaxis(descriptors, axis, 0)[beyond] = 0
        return replace(self, descriptors=descriptors)


class Decoder:
    """Decoding of a camera's images, with what can be computed once for all of them.

    Args:
        color: black level and crosstalk.
        shifts: of the pattern's channels, radians.
        mosaic: (2, 2) channel numbers of a Bayer sensor, or None.
        slopes: expected phase steps per pixel in this camera's image, (x, y) radians; one of them is 0.
        chromatic: correction of lateral chromatic aberration, with the shifts that go with it; None = none.
    """

    def __init__(
        self,
        color: ColorModel,
        shifts: tuple[float, float, float],
        *,
        mosaic: NDArray[np.int64] | None,
        slopes: tuple[float, float],
        settings: Settings,
        chromatic: ChromaticCorrection | None = None,
    ) -> None:
        chromatic = ChromaticCorrection.none(shifts) if chromatic is None else chromatic
        shifts, self._chromatic = chromatic.shifts, chromatic
        self._color, self._plain = color, _Matrices.of(color, shifts, NO_CAST)
        self._black = color.black.astype(np.float32)
        self._mosaic = mosaic
        self._axis = "x" if abs(slopes[0]) > abs(slopes[1]) else "y"
        self._period_px = 2 * np.pi / max(abs(slopes[0]), abs(slopes[1]))
        self._colored_from = limits_of(self._period_px)
        self._nominal = np.array([f(slope) for slope in slopes for f in (np.cos, np.sin)], dtype=np.float32)
        self._settings = settings
        self._radius, sigma = settings.window(mosaic=mosaic is not None)
        # By distance along a row or a column, 0 beyond the radius; their product is the window's weight.
        self._weights = np.zeros(3, np.float32)
        self._weights[: self._radius + 1] = weights_of(self._radius, sigma)[self._radius, self._radius :]
        self._planes: dict[str, NDArray[Any]] = {}
        self._correction: tuple[NDArray[np.int32], F32] | None = None

    @staticmethod
    def of_left(
        calibration: Calibration, pattern: ColorFringe, *, mosaic: NDArray[np.int64] | None,
        slopes: tuple[float, float], settings: Settings, depth_mm: float,
    ) -> Decoder:  # fmt: skip
        """The left camera's decoder (pass ``calibration.swapped()`` for the right one), its colours corrected.

        Args:
            depth_mm: middle of the measuring volume along that camera's axis; the rest as above.
        """
        color = calibration.left_color
        chromatic = chromatic_correction(calibration, pattern, color, depth_mm)
        return Decoder(
            color, pattern.shifts, mosaic=mosaic, slopes=slopes, settings=settings, chromatic=chromatic,
        )  # fmt: skip

    def correct(self, error: NDArray[np.float64], factor: NDArray[np.float64] = EVEN) -> None:
        """Correct the descriptors of the images that follow.

        Args:
            error: (6,) radians, subtracted from normalised phases, see :func:`.pixel_descriptor.periodic`.
            factor: (7,) by which means are multiplied, see :func:`.pixel_descriptor.over_the_image`.
        """
        needed = error.any() or (factor != EVEN).any()
        self._correction = (correction_table(error), factor.astype(np.float32)) if needed else None

    def cast(self, image: NDArray[np.uint8]) -> Cast:
        """Colour cast of a raw image."""
        return cast_of(
            image, self._mosaic, axis=self._axis, period_px=self._period_px, black=self._black, unmix=self._plain.unmix
        )

    def decode(self, image: NDArray[np.uint8], cast: Cast = NO_CAST) -> PhaseMap:
        """Phase of a raw image, (H, W, 3) three-chip or (H, W) mosaic; overwrites the last image's planes.

        Args:
            cast: whose gains and contrasts are made equal; the same for both cameras.
        """
        image = read_only(image)
        m = self._plain if cast is NO_CAST else _Matrices.of(self._color, self._chromatic.shifts, cast)
        noise = self._noise(image)
        height, width = image.shape[:2]
        box = self._box(width, height)
        planes = self._scratch(height, width)
        mean, modulation = (np.empty((height, width), np.uint8) for _ in range(2))
        common = (
            self._black, m.solve, m.mix, m.light, m.unmix, m.ideal, self._weights, self._radius, self._nominal,
            np.float32(self._settings.saturation), np.float32(noise.floor), np.float32(noise.gain),
            np.float32(self._settings.min_modulation), box.along, box.over, box.drops, np.float32(box.scale),
            self._colored_from, self._chromatic.table, self._chromatic.step,
            planes["phasor"], planes["descriptors"], mean, planes["brightness"], planes["variance"], planes["phase"],
            modulation, planes["valid"], planes["saturated"],
        )  # fmt: skip
        if self._mosaic is None:
            decode_rgb(BANDS, image.reshape(height, 3 * width), *common)
        else:
            decode_bayer(BANDS, image, self._mosaic, m.rows, *common)
        if self._correction is not None:
            correct_descriptors(height, *self._correction, planes["descriptors"])
        return PhaseMap(
            planes["phasor"], planes["descriptors"], mean, planes["variance"],
            float(planes["saturated"].sum()) / (height * width), planes["phase"],
            modulation, planes["valid"], planes["brightness"],
        )  # fmt: skip

    def color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Colour of every pixel without the fringes, (H, W, 3) uint8: a white surface has equal channels.

        Crosstalk and balance of the calibration are corrected; values are linear in the light, in counts above black,
        as the mean is.

        Args:
            image: as for :meth:`decode`, whose results stay valid.
        """
        height, width = image.shape[:2]
        box, samples, unit = self._box(width, height), read_only(image.reshape(height, -1)), 1.0
        if self._mosaic is not None:
            colors = np.empty((height, 3 * width), np.uint16)
            rough_colors(height, samples, self._mosaic, colors)
            samples, unit = colors, 1 / EIGHTHS
        out = np.empty((height, width, 3), np.uint8)
        color_texture(
            COLOR_BANDS, samples, np.float32(unit), self._black, self._plain.unmix, self._plain.ideal, box.along,
            box.over, box.drops, np.float32(box.scale), self._chromatic.table, self._chromatic.step,
            out.reshape(height, -1),
        )  # fmt: skip
        return out

    def _box(self, width: int, height: int) -> BoxMean:
        """The mean over a fringe period, of counts or, in a mosaic, of their eighths."""
        largest, unit = (255, 1.0) if self._mosaic is None else (255 * EIGHTHS, 1 / EIGHTHS)
        return BoxMean.of(self._period_px, (width, height), axis=self._axis, largest=largest, unit=unit)

    def _scratch(self, height: int, width: int) -> dict[str, NDArray[Any]]:
        """Planes that are reused: allocating them for every image would take a good part of the decoding time."""
        if not self._planes or self._planes["phase"].shape != (height, width):
            single = {k: np.empty((height, width), np.float32) for k in ("variance", "phase")}
            double = {k: np.empty((height, width), np.int32) for k in ("phasor", "descriptors")}
            rest = {"valid": np.empty((height, width), np.bool_), "saturated": np.empty(height, np.int32)}
            self._planes = {**single, **double, **rest, "brightness": np.empty((height, width), np.uint8)}
        return self._planes

    def _noise(self, image: NDArray[np.uint8]) -> NoiseModel:
        if self._settings.read_noise > 0:
            return NoiseModel(self._settings.read_noise**2, self._settings.noise_gain)
        return estimate(
            image, along=0 if self._axis == "x" else 1, step=1 if self._mosaic is None else 2,
            saturation=self._settings.saturation,
        )  # fmt: skip


class _Matrices(NamedTuple):
    """Matrices (3, 3) float32 of the decoding kernels, whose arguments explain them."""

    rows: F32
    solve: F32
    ideal: F32
    light: F32
    mix: F32
    unmix: F32

    @staticmethod
    def of(color: ColorModel, shifts: tuple[float, float, float], cast: Cast) -> _Matrices:
        """Of a camera whose images have this cast."""
        light = light_of(shifts)
        light[:, 1:] *= cast.contrasts[:, None]
        mix, unmix = color.mix * cast.gains, color.unmix / cast.gains[:, None]
        each = mix @ light, np.linalg.inv(mix @ light), np.linalg.inv(light), light, mix, unmix
        return _Matrices(*(matrix.astype(np.float32) for matrix in each))


def design(color: ColorModel, shifts: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rows (a, p, q) of the three camera channels, (3, 3)."""
    return np.asarray(color.mix @ light_of(shifts))


def light_of(shifts: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rows (1, cos, -sin) of the three projector channels, (3, 3)."""
    delta = np.array(shifts)
    return np.stack([np.ones(3), np.cos(delta), -np.sin(delta)], axis=1)
