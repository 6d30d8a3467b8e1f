"""The simulator's standard rig with fewer pixels, its moving scene, and both again with rows and columns exchanged."""

import dataclasses
import functools

import numpy as np

from pipeline.common.settings import Settings
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.renders import render_pair

LAYOUT = RigLayout().scaled(0.375)
SETTINGS = Settings(cluster_min_area=40)
PERIODS = 36.0
RATE_HZ = 30.0


@functools.cache
def pair(scene, number=0, encoding="rgb8"):
    """A pair of a scene, ``number`` frames after its begin, with its truth; every pair has a noise of its own."""
    pattern = LAYOUT.pattern(PERIODS)
    time, noise = number / RATE_HZ, 100 + number
    return render_pair(LAYOUT, build(scene), pattern, Optics(), time, noise, encoding)


def images(rendered, axis="x"):
    """Left and right image of a rendered pair; axis y: mirrored at the diagonal, so that its fringes lie."""
    pair = rendered.left, rendered.right
    shown = pair if axis == "x" else tuple(np.ascontiguousarray(p.swapaxes(0, 1)) for p in pair)
    # Read-only, as the reconstruction has them: for others the kernels that decode would be compiled once more.
    for image in shown:
        image.setflags(write=False)
    return shown


def upright(cloud, axis="x"):
    """Points (H, W, 3) and orders (H, W) of a cloud as the unmirrored rig would have them."""
    if axis == "x":
        return cloud.xyz, cloud.order
    return cloud.xyz.swapaxes(0, 1)[..., [1, 0, 2]], cloud.order.T


def reconstructor(axis="x", **options):
    calibration, pattern = LAYOUT.calibration_for(Optics()), LAYOUT.pattern(PERIODS)
    if axis == "y":
        calibration = mirrored(calibration)
        pattern = dataclasses.replace(pattern, size=pattern.size[::-1], axis="y")
    return Reconstructor(calibration, pattern, LAYOUT.volume(), **({"settings": SETTINGS} | options))


def mirrored(calibration):
    """The rig with x and y exchanged in every frame; skews, of less than a hundredth of a pixel, are left out."""
    swap = np.eye(3)[[1, 0, 2]]

    def device(d):
        matrix = swap @ d.matrix @ swap
        matrix[1, 0] = 0.0
        k1, k2, p1, p2, k3 = d.distortion
        return CameraModel(
            d.size[::-1], matrix, np.array([k1, k2, p2, p1, k3]), swap @ d.rotation @ swap, swap @ d.translation, d.name
        )

    return Calibration(
        device(calibration.left), device(calibration.right), device(calibration.projector),
        calibration.left_color, calibration.right_color, calibration.response,
    )  # fmt: skip


def same(one, other):
    """Whether two clouds are the same, bit by bit."""
    return all(
        getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ("xyz", "sigma_mm", "order", "gray")
    )
