"""Parameters of light, lenses, colours and sensor, from the image sent to the counts read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

# The shape of the crosstalk matrix differs from camera to camera; it is scaled by ``crosstalk``.
_CROSSTALK_SHAPES = (
    ((0.0, 0.9, 0.3), (1.0, 0.0, 0.8), (0.2, 1.1, 0.0)),
    ((0.0, 1.0, 0.25), (0.8, 0.0, 1.0), (0.3, 0.9, 0.0)),
)
_ERROR_SHAPE = ((0.0, 1.0, -1.0), (-1.0, 0.0, 1.0), (1.0, -1.0, 0.0))
# The standard fringe peaks at 245.5 in one channel while the other two are at 68.5.
_PEAK_LIGHT, _VALLEY_LIGHT = 245.5, 68.5
WHITE_ALBEDO = 0.9


@dataclass(frozen=True, slots=True)
class Optics:
    """Light and sensor of a simulated rig; the defaults are the standard benchmark.

    Args:
        gamma: exponent of the projector's response; 1 = linear.
        precorrected: whether the pattern is corrected by the inverse of the response.
        defocus_px: standard deviation of the projector's blur, projector pixels.
        color_shift_px: displacement of red, green and blue to the right of their column, projector pixels.
        projector_error_px: shift and edge stretch by which the *calibrated* projector is wrong, pixels.
        ambient: ambient light as a share of full projector light, black of the projector included.
        crosstalk: about the largest off-diagonal entry of the cameras' crosstalk.
        crosstalk_error: relative error of the off-diagonal entries in the calibration.
        psf_px: standard deviation of the cameras' blur, camera pixels.
        chromatic: difference of magnification of red (-) and blue (+) against green; 2e-4 is 0.1 px at the edge.
        black_dn: black level, counts.
        white_dn: counts of a white board facing the projector at the stand-off, at the fringe's peak.
        exposure: factor on the light, 1 = well exposed, 1.8 = over-exposed.
        full_well_e: electrons at 255 counts; 0 = no shot noise.
        read_noise_dn: standard deviation, counts.
        noise: factor on all noise; 0 = no noise and no rounding error other than 8 bit.
        exposure_us: exposure time; the image is the mean over it.
        supersampling: rays per pixel, along each axis; in moving scenes each has its own instant.
    """

    gamma: float = 1.0
    precorrected: bool = True
    defocus_px: float = 0.7
    color_shift_px: Triple = (0.0, 0.0, 0.0)
    projector_error_px: tuple[float, float] = (0.0, 0.0)
    ambient: float = 0.02
    crosstalk: float = 0.10
    crosstalk_error: float = 0.0
    psf_px: float = 0.5
    chromatic: float = 0.0
    black_dn: float = 4.0
    white_dn: float = 230.0
    exposure: float = 1.0
    full_well_e: float = 10_000.0
    read_noise_dn: float = 0.8
    noise: float = 1.0
    exposure_us: float = 8_000.0
    supersampling: int = 2

    def __post_init__(self) -> None:
        for key in ("gamma", "white_dn", "exposure"):
            if not getattr(self, key) > 0:
                raise ValueError(f"optics.{key} is {getattr(self, key)}, expected more than 0")
        for key in ("defocus_px", "ambient", "psf_px", "black_dn", "full_well_e", "read_noise_dn", "noise"):
            if not getattr(self, key) >= 0:
                raise ValueError(f"optics.{key} is {getattr(self, key)}, expected 0 or more")
        if not 1 <= self.supersampling <= 8:
            raise ValueError(f"optics.supersampling is {self.supersampling}, expected 1 to 8")

    @classmethod
    def realistic(cls, **changes: Any) -> Optics:
        """A rig calibrated with ordinary care: every known fault at its usual size (encode as Bayer to complete it)."""
        values: dict[str, Any] = {
            "gamma": 2.2,
            "defocus_px": 1.2,
            "color_shift_px": (0.3, 0.0, -0.3),
            "projector_error_px": (0.3, 0.1),
            "crosstalk_error": 0.10,
            "chromatic": 2e-4,
        }
        return cls(**(values | changes))

    @classmethod
    def ideal(cls, **changes: Any) -> Optics:
        """No noise, no blur, no crosstalk, no ambient light: for exact tests."""
        values: dict[str, Any] = {
            "defocus_px": 0.0,
            "ambient": 0.0,
            "crosstalk": 0.0,
            "psf_px": 0.0,
            "noise": 0.0,
            "black_dn": 0.0,
        }
        return cls(**(values | changes))

    def true_crosstalk(self) -> Array:
        """Crosstalk of the left and the right camera, (2, 3, 3); ones on the diagonals."""
        return np.eye(3) + self.crosstalk * np.array(_CROSSTALK_SHAPES)

    def calibrated_crosstalk(self) -> Array:
        """The crosstalk of the calibration, (2, 3, 3)."""
        return np.eye(3) + self.crosstalk * np.array(_CROSSTALK_SHAPES) * (
            1 + self.crosstalk_error * np.array(_ERROR_SHAPE)
        )

    def response_table(self) -> tuple[Array, Array]:
        """Drive levels (256,) and relative light of each channel (3, 256)."""
        levels = np.arange(256.0)
        return levels, np.tile((levels / 255) ** self.gamma, (3, 1))

    def light_of(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Light of an image sent, (H, W, 3), 0..255, before blur."""
        table = (255 * (np.arange(256.0) / 255) ** self.gamma).astype(np.float32)
        return np.asarray(table[image])

    def gain(self, camera: int) -> float:
        """Counts per unit of light times albedo, so that a white board peaks at ``white_dn``."""
        rows = self.true_crosstalk()[camera]
        strongest = _PEAK_LIGHT + _VALLEY_LIGHT * float((rows.sum(axis=1) - 1).max()) + 255 * self.ambient
        return self.exposure * (self.white_dn - self.black_dn) / (WHITE_ALBEDO * strongest)


def crosstalk_shape(camera: int) -> Array:
    """Crosstalk of a camera, (3, 3), scaled to size 1; 0 on the diagonal."""
    return np.array(_CROSSTALK_SHAPES[camera])
