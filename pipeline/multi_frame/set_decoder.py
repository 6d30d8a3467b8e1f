"""From one camera's images of a set to a phase map with orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import ImageError
from pipeline.common.settings import Settings
from pipeline.decode.decoder import PhaseMap
from pipeline.decode.noise_model import NoiseModel, estimate
from pipeline.decode.pixel_descriptor import descriptors_without_color
from pipeline.decode.raw_image import BAYER
from pipeline.multi_frame import n_step_kernel, temporal_unwrapping
from pipeline.multi_frame.image_roles import Plan
from pipeline.multi_frame.phase_limits import PhaseLimits
from pipeline.multi_frame.phase_smoothing import blend, smooth
from pipeline.multi_frame.second_harmonic import second_harmonics
from pipeline.rig.calibration import ColorModel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
_DEEP = 257.0
_SHAPES = {"rgb8": (3, np.uint8), "mono8": (1, np.uint8), "mono16": (1, np.uint16)} | dict.fromkeys(
    BAYER, (1, np.uint8)
)
ENCODINGS = tuple(_SHAPES)


@dataclass(frozen=True, slots=True, eq=False)
class SetPhase:
    """Phases and orders of one camera's set of images; the next set overwrites all planes but ``map.modulation``.

    Args:
        map: phases of the finest fringe, as of the single shot.
        order: (H, W) int16, orders, -32768 where unknown; absolute_phase: (H, W) float32, radians, NaN likewise.
        moved: number of lit pixels whose images contradict each other.
    """

    map: PhaseMap
    order: NDArray[np.int16]
    absolute_phase: F32
    moved: int


class SetDecoder:
    """Decoding of a camera's sets of grey images, with what can be computed once for all of them.

    Args:
        plan: roles of the images; color: black level and crosstalk; tables: limits of the absolute phase.
        encoding: of the images, one of :data:`ENCODINGS`.
        limits: largest deviation of orders, largest misfit, radians.
    """

    def __init__(
        self, plan: Plan, color: ColorModel, tables: PhaseLimits, *, encoding: str, settings: Settings,
        limits: tuple[float, float],
    ) -> None:  # fmt: skip
        self._plan, self._phase_limits, self._settings, self._encoding, self._limits = (
            plan,
            tables,
            settings,
            encoding,
            limits,
        )
        self._channels, self._type = _SHAPES[encoding]
        self._scale = np.float32(1 / _DEEP if encoding == "mono16" else 1.0)
        self._black, self._share = _levels(color, encoding)
        self._index = np.array([n for f in plan.fringes for n in f.frames], np.int32)
        self._first = np.cumsum([0, *(len(f.frames) for f in plan.fringes)]).astype(np.int32)
        self._solve = np.concatenate([f.solve for f in plan.fringes], axis=1).astype(np.float32)
        widest = max(len(f.frames) for f in plan.fringes)
        rows = [np.pad(f.rest, ((0, 0), (0, widest - len(f.frames)))) for f in plan.fringes]
        self._rest = np.ascontiguousarray(np.concatenate(rows), dtype=np.float32)
        self._rest_first = np.cumsum([0, *(len(f.rest) for f in plan.fringes)]).astype(np.int32)
        ratio = np.array([f.periods / plan.periods for f in plan.fringes])
        self._ratio = ratio.astype(np.float32)
        self._weight = plan.shares.astype(np.float32)
        width, height = tables.size
        self._stack = np.empty((plan.frames, height, width * self._channels), self._type)
        many = (len(plan.fringes), height, width)
        self._phase, self._amplitude, self._variance = (np.empty(many, np.float32) for _ in range(3))
        self._mean, self._misfit = (np.empty((height, width), np.float32) for _ in range(2))
        self._order = np.empty((height, width), np.int16)
        self._phasor, self._descriptors = (np.empty((height, width), np.int32) for _ in range(2))
        self._saturated = np.empty(height, np.int32)
        self._mosaic, self._window = encoding in BAYER, windowed(settings, encoding)
        self._spare = np.empty((3 if self._mosaic or self._window else 0, height, width), np.float32)
        self._bits = np.empty((len(plan.bits), height, width), np.int8)
        self._bit_index = np.array([frame for frame, _ in plan.bits], np.int32)
        self._bit_sign = np.array([-1 if b.inverted else 1 for _, b in plan.bits], np.float32)
        self._number = np.array([b.bits - 1 - b.bit for _, b in plan.bits], np.int32)

    def decode(self, images: Sequence[NDArray[Any]], side: str) -> SetPhase:
        """Phases and orders of a set of raw images; ``side`` is for errors."""
        self._take(images, side)
        noise = self._noise(images[self._index[0]])
        s, min_amplitude = self._settings, np.float32(self._settings.min_modulation)
        given = (
            self._stack, self._channels, self._scale, self._black, self._share, np.float32(s.saturation),
            np.float32(noise.floor), np.float32(noise.gain), self._index, self._first, self._solve, self._rest,
            self._rest_first,
        )  # fmt: skip
        harmonic = second_harmonics(self._plan, self._stack, self._channels, float(min_amplitude)).astype(np.float32)
        n_step_kernel.phases(
            len(self._mean), *given, harmonic, self._bit_index, self._bit_sign, self._phase, self._amplitude,
            self._variance, self._mean, self._misfit, self._bits, self._saturated,
        )  # fmt: skip
        self._decide(min_amplitude)
        return self._unwrapped(min_amplitude)

    def _decide(self, min_amplitude: np.float32) -> None:
        """The orders, from a Gray code or from several fringes."""
        plan = self._plan
        planes = self._phase, self._amplitude, self._variance, self._phase_limits.low, self._phase_limits.high
        if plan.bits:
            fringe = plan.fringes[0]
            temporal_unwrapping.by_bits(
                len(self._order), *planes, self._bits, self._number, np.float32(plan.bits[0][1].cells / fringe.periods),
                len(fringe.frames), min_amplitude, self._misfit, self._order, self._phasor,
            )  # fmt: skip
        else:
            temporal_unwrapping.by_phase(
                len(self._order), *planes, self._ratio, self._weight, min_amplitude, np.float32(self._limits[0]),
                self._misfit, self._order, self._phasor,
            )  # fmt: skip

    def _unwrapped(self, min_amplitude: np.float32) -> SetPhase:
        absolute_phase = self._phase[0].copy()
        amplitude = self._amplitude[0]
        moved = temporal_unwrapping.reject_moved(
            self._order, self._phasor, amplitude, self._misfit, self._variance[0], min_amplitude,
            np.float32(self._limits[1]), absolute_phase,
        )  # fmt: skip
        phase, variance, mean = self._phase[0], self._variance[0], self._mean
        if self._window:
            smooth(len(self._order), absolute_phase, variance, self._order, phase, self._phasor, *self._spare[:2])
            absolute_phase, variance = self._spare[0], self._spare[1]
        if self._mosaic:
            blend(len(self._mean), self._mean, self._spare[2])
            mean = self._spare[2]
        counts = np.rint(mean).clip(0, 255).astype(np.uint8)
        modulation = np.minimum(amplitude, 255).astype(np.uint8)
        share = float(self._saturated.sum()) / self._saturated.size / self._phase_limits.size[0]
        valid = self._order != temporal_unwrapping.NONE
        descriptors_without_color(len(phase), phase, valid, counts, self._descriptors)
        found = PhaseMap(self._phasor, self._descriptors, counts, variance, share, phase, modulation, valid, counts)
        return SetPhase(found, self._order, absolute_phase, int(moved))

    def _take(self, images: Sequence[NDArray[Any]], side: str) -> None:
        """Copy the images into one array; ImageError unless all fit."""
        if len(images) != self._plan.frames:
            raise ImageError(f"{len(images)} {side} images of a set of {self._plan.frames}; expected one each")
        width, height = self._phase_limits.size
        shape = (height, width, 3) if self._channels == 3 else (height, width)
        for number, image in enumerate(images):
            if image.shape != shape or image.dtype != self._type:
                raise ImageError(
                    f"{side} image {number} of the set is {image.dtype} {image.shape}, but {self._encoding} of "
                    f"the calibrated camera is {np.dtype(self._type)} {shape}; use the calibration of this camera and "
                    "its region of interest"
                )
            self._stack[number] = image.reshape(height, -1)

    def _noise(self, image: NDArray[Any]) -> NoiseModel:
        if self._settings.read_noise > 0:
            return NoiseModel(self._settings.read_noise**2, self._settings.noise_gain)
        shallow = (image >> 8).astype(np.uint8) if self._encoding == "mono16" else image
        return estimate(shallow, along=0 if self._plan.axis == "x" else 1, step=2 if self._encoding in BAYER else 1)


def windowed(settings: Settings, encoding: str) -> bool:
    """Whether phases are averaged over 3 x 3 pixels: on a mosaic, or where the settings ask for a window."""
    return encoding in BAYER or settings.window_radius > 0


def _levels(color: ColorModel, encoding: str) -> tuple[F32, F32]:
    """Black level and answer to white light of a row's and a column's parity, two times (2, 2, channels)."""
    white = color.mix.sum(axis=1)
    if encoding in BAYER:
        mosaic = np.array(BAYER[encoding])
        return color.black[mosaic][..., None].astype(np.float32), white[mosaic][..., None].astype(np.float32)
    black, share = (color.black, white) if encoding == "rgb8" else (color.black.mean(keepdims=True), np.ones(1))
    return tuple(np.ascontiguousarray(np.broadcast_to(x, (2, 2, len(x))), np.float32) for x in (black, share))  # type: ignore[return-value]
