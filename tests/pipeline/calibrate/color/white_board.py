"""A white board in front of two cameras, computed from the formulas, with adjustable faults."""

import functools
from dataclasses import dataclass, field

import numpy as np

from pipeline.decode.raw_image import BAYER
from pipeline.pattern.projected_frames import Uniform
from pipeline.rig.calibration import Calibration, Response
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.lateral_chromatic import LateralChromatic, Registration

CAMERA, PROJECTOR = (208, 160), (256, 200)
MIX = np.eye(3) + 0.12 * np.array(
    [[[0, 0.9, 0.3], [1, 0, 0.8], [0.2, 1.1, 0]], [[0, 1, 0.25], [0.8, 0, 1], [0.3, 0.9, 0]]]
)
# Projector pixels of camera pixels: about 1.2 of them per pixel, in perspective, and not the same in both cameras.
HOMOGRAPHIES = (
    np.array([[1.22, 0.02, 2.0], [-0.01, 1.21, 3.0], [1.2e-4, 2e-5, 1.0]]),
    np.array([[1.17, -0.03, 5.0], [0.02, 1.20, 2.0], [-1.4e-4, 3e-5, 1.0]]),
)


@functools.cache
def rig():
    """Cameras and projector whose geometry only gives the principal points and focal lengths here."""
    matrix = np.array([[690.0, 0, 103.0], [0, 690.0, 80.0], [0, 0, 1]])
    left = CameraModel(CAMERA, matrix, name="left")
    right = CameraModel(CAMERA, matrix, translation=np.array([-500.0, 0, 0]), name="right")
    lamp = CameraModel(
        PROJECTOR, np.array([[850.0, 0, 128], [0, 850.0, 100], [0, 0, 1]]), translation=np.array([-190.0, 0, 0])
    )
    return Calibration(left, right, lamp)


@dataclass
class WhiteBoard:
    """Images of a board; counts are ``black + albedo (gain mix (light + glow + ambient))``."""

    gamma: tuple = (2.2, 2.2, 2.2)
    mix: np.ndarray = field(default_factory=lambda: MIX)
    gain: tuple = (0.90, 0.90, 0.90)
    black: float = 4.0
    ambient: float = 5.0
    noise: float = 1.0
    marks: bool = False
    lateral_chromatic: LateralChromatic | None = None
    registration: Registration | None = None
    encoding: str = "rgb8"

    def response(self):
        levels = np.arange(256.0)
        return Response(levels, np.stack([(levels / 255) ** g for g in self.gamma]))

    @functools.cached_property
    def albedo(self):
        v, u = np.mgrid[0 : CAMERA[1], 0 : CAMERA[0]]
        out = 0.9 - 0.15 * ((u - 100) / 104.0) ** 2
        if self.marks:
            out[((u % 26 - 13) ** 2 + (v % 26 - 13) ** 2) < 36] = 0.05
        return out

    @functools.cached_property
    def places(self):
        """Projector pixels of the camera pixels, (2 cameras, 3 channels, height, width, 2)."""
        v, u = np.mgrid[0 : CAMERA[1], 0 : CAMERA[0]].astype(float)
        pixels = np.stack([u, v], axis=-1)
        out = np.empty((2, 3, *pixels.shape))
        for side, camera in enumerate((rig().left, rig().right)):
            for k in range(3):
                moved = 0 if self.lateral_chromatic is None else self.lateral_chromatic.at(camera, pixels)[k]
                out[side, k] = projected(pixels - moved, side)
                if self.registration is not None:
                    out[side, k] -= self.registration.at(PROJECTOR, out[side, k])[k]
        return out

    def light(self, frame, side, shown=None):
        """Light of the three channels at every pixel of a camera, 0..255."""
        drive = frame.image(shown)
        line, axis = (drive[:, 0], 1) if not isinstance(frame, Uniform) and frame.axis == "y" else (drive[0], 0)
        light = 255 * (line / 255.0) ** np.array(self.gamma)
        if isinstance(frame, Uniform):
            return np.broadcast_to(light[0], (*CAMERA[::-1], 3))
        return np.stack([spline(light[:, k], self.places[side, k, ..., axis]) for k in range(3)], axis=-1)

    def image(self, frame, side, seed=0, shown=None, exposure=1.0, cap=False):
        light = self.light(frame, side, shown) + self.ambient
        counts = exposure * self.albedo[..., None] * (light @ (self.mix[side] * np.array(self.gain)).T)
        counts = (0 if cap else 1) * counts + self.black
        counts += self.noise * np.random.default_rng([seed, side]).standard_normal(counts.shape)
        rgb = np.clip(np.rint(counts), 0, 255).astype(np.uint8)
        if self.encoding == "rgb8":
            return rgb
        v, u = np.mgrid[0 : CAMERA[1], 0 : CAMERA[0]]
        colors = np.array(BAYER[self.encoding])[v & 1, u & 1]
        return np.take_along_axis(rgb, colors[..., None], axis=2)[..., 0]

    def capture(self, sequence, *, seed=0, shown=None, **more):
        return [
            tuple(self.image(frame, side, 1000 * seed + i, shown, **more) for side in (0, 1))
            for i, frame in enumerate(sequence.frames)
        ]


def projected(pixels, side):
    h = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1) @ HOMOGRAPHIES[side].T
    return h[..., :2] / h[..., 2:]


def spline(line, at):
    """A line of projector pixels, joined by quadratic splines as the pixels of an image are by their blur."""
    j = np.clip(np.rint(at).astype(int), 1, len(line) - 2)
    f = at - j
    return 0.5 * (0.5 - f) ** 2 * line[j - 1] + (0.75 - f * f) * line[j] + 0.5 * (0.5 + f) ** 2 * line[j + 1]
