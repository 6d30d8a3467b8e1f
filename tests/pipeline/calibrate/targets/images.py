"""Images of boards with known truth: the drawing projected by the full camera model, four samples across a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.board_drawing import raster
from pipeline.calibrate.targets.localise import circle_projection
from pipeline.rig.camera_model import CameraModel

LENS = (-0.12, 0.2, 0.0008, -0.0006, -0.3)


@dataclass(frozen=True)
class Pose:
    """Board to device; the board's middle stands at ``at_mm`` and is turned about its own x, y and z axes."""

    x_deg: float = 0.0
    y_deg: float = 0.0
    z_deg: float = 0.0
    at_mm: tuple[float, float, float] = (0.0, 0.0, 1400.0)

    def of(self, board: Board):
        turns = [cv2.Rodrigues(np.radians(angles))[0] for angles in np.diag([self.x_deg, self.y_deg, self.z_deg])]
        rotation = turns[0] @ turns[1] @ turns[2]
        middle = (board.points.min(axis=0) + board.points.max(axis=0)) / 2
        return rotation, np.array(self.at_mm) - rotation @ middle


def camera(width=512, height=410, focal=1700.0, distortion=LENS):
    matrix = [[focal, 0, width / 2 - 5.3], [0, focal * 1.002, height / 2 + 3.7], [0, 0, 1]]
    return CameraModel((width, height), matrix, distortion)


def clean(board, device, pose, *, blur_px=0.7, shade=(0.0, 0.0), light=200.0, dark=0.04, background=0.25, ss=4):
    """Noiseless light (H, W) float32, 0 to about ``light``.

    Args:
        blur_px: sigma of the lens's blur.
        shade: relative change of the light across the whole image, right and down.
    """
    rotation, translation = pose.of(board)
    width, height = device.size
    rays = _rays(device)
    normal = rotation[:, 2]
    depth = (normal @ translation) / (rays @ normal)
    at = (rays * depth[..., None] - translation) @ rotation[:, :2]
    # Pixels of the drawing as large as the samples are apart: linear interpolation then keeps every edge in its place.
    step = float(np.median(depth)) / device.matrix[0, 0] / ss
    paper, origin = raster(board, step)
    positions = ((at - origin) / step).astype(np.float32)
    fine = cv2.resize(positions, (width * ss, height * ss), interpolation=cv2.INTER_LINEAR)
    albedo = dark + (0.9 - dark) * paper
    seen = cv2.remap(albedo, fine[..., 0], fine[..., 1], cv2.INTER_LINEAR, borderValue=background)
    u, v = (np.arange(n * ss) / (n * ss) - 0.5 for n in (width, height))
    seen *= light / 0.9 * (1 + shade[0] * u[None] + shade[1] * v[:, None]).astype(np.float32)
    if blur_px:
        seen = cv2.GaussianBlur(seen, (0, 0), blur_px * ss)
    return cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA)


@lru_cache(maxsize=4)
def _rays(device):
    """(H, W, 3); one device sees many poses."""
    return np.dstack([device.rays(), np.ones(device.size[::-1])])


def noisy(light, seed=0, *, full_well=10_000.0, read_dn=0.8, gain=1.0):
    """An 8-bit image: shot noise, read noise, rounding, clipping."""
    rng = np.random.default_rng(seed)
    light = np.clip(light, 0, None) * gain
    sigma = np.sqrt(light * 255 / full_well + read_dn**2)
    return np.clip(np.round(light + sigma * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)


def truth(board, device, pose):
    """Positions of the marks: centroids of circles' images, images of corners."""
    rotation, translation = pose.of(board)
    radius = board.printed_diameter_mm / 2 if board.round else 0.0
    return circle_projection.centroids(device, rotation, translation, board.points, radius)


def centres(board, device, pose):
    """Images of the marks' centres, without the offset of a circle's centroid."""
    rotation, translation = pose.of(board)
    return circle_projection.centroids(device, rotation, translation, board.points, 0.0)
