"""The measured scene of the figures: objects in front of a board, rendered, reconstructed, compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.render.ground_truth import Truth
from sim.render.render_pair import render_pair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.scene import SKIN, Scene
from sim.scene.shapes import Texture, box, cylinder, relief, sphere


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A measured pair of the standard rig.

    Args:
        color: (H, W, 3) float, 0..1, the surface's colour without fringes.
        phase: (H, W), wrapped phase of the left image, rad.
    """

    layout: RigLayout
    pattern: ColorFringe
    left: NDArray[Any]
    right: NDArray[Any]
    cloud: Cloud
    truth: Truth
    phase: NDArray[Any]
    color: NDArray[Any]


def measure(scene: Scene, *, scale: float = 1.0) -> Measurement:
    """Render and reconstruct one pair.

    Args:
        scene: on the stage; scale: of the images' size.
    """
    layout, optics = RigLayout().scaled(scale), Optics()
    pattern, calibration = layout.pattern(), layout.calibration_for(optics)
    pair = render_pair(layout, scene, pattern, optics)
    cloud = Reconstructor(calibration, pattern, layout.volume()).reconstruct(pair.left, pair.right)
    model = calibration.left_color
    light = (pair.left.astype(float) - model.black) @ np.linalg.inv(model.crosstalk).T
    r, g, b = np.moveaxis(light, -1, 0)
    phase = np.arctan2(np.sqrt(3) * (r - b), 2 * g - r - b)
    column = calibration.projector.project(cloud.xyz.reshape(-1, 3).astype(float))[:, 0].reshape(phase.shape)
    projected = 2 * np.pi * pattern.periods * (column + 0.5) / pattern.length
    color = _without_fringes(light, projected[..., None] + np.array(pattern.shifts))
    return Measurement(layout, pattern, pair.left, pair.right, cloud, pair.truth_left, phase, color)


def _without_fringes(light: NDArray[Any], phase: NDArray[Any]) -> NDArray[Any]:
    """The surface's colour: the least-squares factor of the projected fringe, in 3 x 3 pixels of each channel.

    Args:
        light: (H, W, 3), counts; phase: (H, W, 3), rad, of each channel at the measured point; NaN without a point.
    """
    fringe = np.nan_to_num(1 + _VISIBILITY * np.cos(phase))
    known = np.isfinite(phase)
    above, below = (cv2.blur(np.where(known, x * fringe, 0.0), (3, 3)) for x in (light, fringe))
    return np.clip(above / np.maximum(below, 0.05) / _WHITE, 0, 1)


_VISIBILITY, _WHITE = 0.786, 112.0
"""Modulation / mean and mean, counts, of a white plane under the standard optics."""


def objects() -> Scene:
    """A head and four solids, without a board behind them."""
    texture = Texture(smooth=0.12, smooth_mm=30.0, speckle=0.05, speckle_mm=2.0)
    return Scene(
        "objects",
        (
            relief(165, 235, 74).placed((0, 0, 20), albedo=SKIN, texture=texture),
            sphere(44).placed((-145, -75, 0), albedo=(0.80, 0.52, 0.45), texture=texture),
            sphere(27).placed((-120, 45, -35), albedo=(0.80, 0.70, 0.45), texture=texture),
            box(72, 72, 72).placed((142, -62, 10), turn=(0.5, 0.65, 0.1), albedo=(0.48, 0.64, 0.80), texture=texture),
            cylinder(27, 105).placed((140, 80, 10), turn=(-0.2, 0.1, 0.35), albedo=(0.52, 0.74, 0.55), texture=texture),
        ),
    )
