"""Images of fringes made from the formulas alone, decoders for them, and what these compute, in whole planes."""

import cv2
import numpy as np

from pipeline.common.settings import Settings
from pipeline.decode.decoder import Decoder
from pipeline.decode.kernels.local_mean import SHARED
from pipeline.decode.raw_image import BAYER, mosaic_of
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import ColorModel
from tests.pipeline.rigs import CROSSTALK

SHIFTS = ColorFringe().shifts
COLOR = ColorModel(np.array([3.0, 2.0, 4.0]), CROSSTALK)


def wrapped(a):
    return np.angle(np.exp(1j * a))


def smooth_phase(shape=(120, 160), period=11.0):
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    return 2 * np.pi / period * u + 0.4 * np.sin(v / 25) + 0.3 * np.sin(u / 30)


def light(phase, albedo=1.0, ambient=20.0, mean=80.0, amplitude=70.0):
    waves = mean + amplitude * np.cos(phase[..., None] + np.array(SHIFTS))
    return np.asarray(albedo)[..., None] * (waves + ambient) if np.ndim(albedo) else albedo * (waves + ambient)


def image(phase, noise=0.0, seed=0, color=COLOR, **kwargs):
    counts = light(phase, **kwargs) @ color.crosstalk.T + color.black
    counts = counts + noise * np.random.default_rng(seed).standard_normal(counts.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def mosaic(rgb, encoding):
    v, u = np.mgrid[0 : rgb.shape[0], 0 : rgb.shape[1]]
    channel = np.array(BAYER[encoding])[v & 1, u & 1]
    return np.ascontiguousarray(np.take_along_axis(rgb, channel[..., None], axis=2)[..., 0])


def decoder(encoding="rgb8", color=COLOR, **settings):
    return Decoder(
        color, SHIFTS, mosaic=mosaic_of(encoding), slopes=(2 * np.pi / 11, 0.0), settings=Settings(**settings)
    )


INNER = (slice(8, -8), slice(16, -16))


def hard_image(shape=(90, 131), seed=3):
    """Fringes with an edge, a dark and a saturated part, and noise."""
    phase = smooth_phase(shape)
    phase[shape[0] // 2 :, 40:70] += 2.0
    albedo = np.full(shape, 0.9)
    albedo[10:30, 20:60] = 0.0
    albedo[50:80, 80:] = 1.9
    return image(phase, noise=1.0, seed=seed, albedo=albedo)


def levels_of(raw):
    return raw.astype(float) - COLOR.black


def phasors_rows(crosstalk=None):
    shifts = np.array(SHIFTS)
    light_of = np.stack([np.ones(3), np.cos(shifts), -np.sin(shifts)], axis=1)
    return np.linalg.inv((np.eye(3) if crosstalk is None else crosstalk) @ light_of)


def phasors_of(levels, crosstalk=CROSSTALK):
    solution = levels @ phasors_rows(crosstalk).T
    return solution[..., 1] + 1j * solution[..., 2], np.maximum(solution[..., 0], 0)


def local_means_of(channels):
    means = channels
    for _ in range(2):
        means = cv2.blur(means, (11, 5), borderType=cv2.BORDER_REFLECT)
    # Rows share the means of the multiple of three next to them; beyond the image is its mirror image.
    rows = SHARED * ((np.arange(len(means)) + 1) // SHARED)
    return np.maximum(means[np.where(rows < len(means), rows, 2 * len(means) - 1 - rows)], 1)


def normalised_of(levels, sharp=None):
    """Phasors of channels divided by their local means; ``sharp``: other levels than those of the means."""
    channels, divided = (each @ np.linalg.inv(CROSSTALK).T for each in (levels, levels if sharp is None else sharp))
    return phasors_of(divided / local_means_of(channels), np.eye(3))[0]


def equal_contrast_of(levels, own):
    """First guess of a mosaic with samples two pixels away mixed in; own (H, W, 3): 1 for a sample's channel."""
    mixed = levels.copy()
    far = levels[:, :-4] + levels[:, 4:]
    mixed[:, 2:-2] = (6 * levels[:, 2:-2] + far) / 8
    # Red and blue where they have samples in the pixel's column; green everywhere, by half as much.
    column = own + np.roll(own, 1, axis=0)
    mixed = np.where(column > 0, mixed, levels)
    mixed[..., 1] = levels[..., 1]
    mixed[:, 2:-2, 1] = (14 * levels[:, 2:-2, 1] + far[..., 1]) / 16
    return mixed
