"""One trigger: both cameras' images of a scene under projector light, with the truth.

Every pixel is the mean over several rays and, where something moves, over several instants of the exposure. Bands of
rows are rendered by a few threads; the result does not depend on their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Response
from pipeline.rig.camera_model import CameraModel
from sim.render import sensor
from sim.render.ground_truth import Truth, rows_of_truth, stacked
from sim.render.lens import packed, pixel_rays
from sim.render.projected_light import projected_light, shade
from sim.rig.disturbance import TrueRig
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.ray_hits import Surfaces, surfaces
from sim.scene.scene import Scene

Image = NDArray[np.uint8] | NDArray[np.uint16]
T = TypeVar("T")
_BAND_ROWS = 32


@dataclass(frozen=True, slots=True, eq=False)
class RenderedPair:
    """Images of one trigger, in the sensor's encoding, and their truth."""

    left: Image
    right: Image
    truth_left: Truth
    truth_right: Truth
    encoding: str = "rgb8"


def render_pair(
    layout: RigLayout,
    scene: Scene,
    pattern: ColorFringe | NDArray[np.uint8],
    optics: Optics | None = None,
    t_s: float = 0.0,
    seed: int = 0,
    encoding: str = "rgb8",
) -> RenderedPair:
    """Both images of one exposure and their truth.

    Args:
        layout: the rig.
        scene: on the stage.
        pattern: a fringe (corrected by the inverse response if the optics are precorrected), or the projected image
            (H, W, 3) uint8; then the truth has no fringe orders.
        optics: light, lenses and sensor; the standard ones if None.
        t_s: start of the exposure in the scene's time.
        seed: of the noise; the same seed gives the same images.
        encoding: ``rgb8`` (three chips), ``bayer_rggb8`` and the other Bayer mosaics, ``mono8``, ``mono16``.
    """
    optics = Optics() if optics is None else optics
    images = render_images(layout, scene, pattern, optics, t_s, seed, encoding)
    fringe = pattern if isinstance(pattern, ColorFringe) else None
    left, right = truths(layout, scene, fringe, t_s + 0.5e-6 * optics.exposure_us)
    return RenderedPair(*images, left, right, encoding)


def render_images(
    layout: RigLayout,
    scene: Scene,
    pattern: ColorFringe | NDArray[np.uint8],
    optics: Optics,
    t_s: float = 0.0,
    seed: int = 0,
    encoding: str = "rgb8",
) -> tuple[Image, Image]:
    """The images of :func:`render_pair` without the truth, in two thirds of the time."""
    return with_noise(render_counts(layout, scene, pattern, optics, t_s, encoding), optics, seed, encoding)


def render_counts(
    layout: RigLayout,
    scene: Scene,
    pattern: ColorFringe | NDArray[np.uint8],
    optics: Optics,
    t_s: float = 0.0,
    encoding: str = "rgb8",
    rig: TrueRig | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Counts above black of both cameras without noise or rounding, in the sensor's layout.

    ``rig`` is a disturbed rig instead of that of the layout and the optics.
    """
    rig = TrueRig.of(layout, optics) if rig is None else rig
    light = projected_light(image_sent(pattern, optics, rig.projector.size), optics)
    left, right = (
        sensor.exposed(
            light_on_sensor(layout, rig.projector, scene, light, optics, t_s, device),
            camera,
            optics,
            encoding,
            rig.crosstalk[camera],
        )
        for camera, device in enumerate((rig.left, rig.right))
    )
    return left, right


def with_noise(
    counts: tuple[NDArray[np.float32], NDArray[np.float32]], optics: Optics, seed: int, encoding: str
) -> tuple[Image, Image]:
    """Images of noiseless counts; the seed determines the noise."""
    left, right = (
        sensor.read_out(image, optics, np.random.default_rng([seed, camera]), encoding)
        for camera, image in enumerate(counts)
    )
    return left, right


def image_sent(pattern: ColorFringe | NDArray[np.uint8], optics: Optics, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image sent to the projector, (H, W, 3) uint8."""
    if isinstance(pattern, ColorFringe):
        corrected = optics.precorrected and optics.gamma != 1.0
        image = pattern.image(Response(*optics.response_table()) if corrected else None)
    else:
        image = pattern
    if image.shape != (size[1], size[0], 3) or image.dtype != np.uint8:
        raise ValueError(
            f"the projected image is {image.shape} {image.dtype}, the projector takes ({size[1]}, {size[0]}, 3) uint8"
        )
    return image


def light_on_sensor(
    layout: RigLayout,
    projector: CameraModel,
    scene: Scene,
    light: NDArray[np.float32],
    optics: Optics,
    t_s: float,
    camera: CameraModel,
) -> NDArray[np.float32]:
    """Light that reaches each pixel of a camera during the exposure, (H, W, 3), R G B of the projector, 0..255."""
    s = optics.supersampling
    rows, columns = camera.size[1], camera.size[0]
    stage = layout.stage_pose()
    if not scene.moves:
        lattice = _Lattice(1 / s, 0.5 / s - 0.5, 0.5 / s - 0.5, rows * s, columns * s)
        return sensor.blurred(
            _light_at(surfaces(scene, t_s, stage), layout, projector, light, optics, camera, lattice), optics
        )
    rays = np.empty((rows * s, columns * s, 3), np.float32)
    for i in range(s):
        for j in range(s):
            # Each ray of a pixel has its own instant, in alternating order, so that time and column do not correlate.
            instant = s * i + (j if i % 2 == 0 else s - 1 - j)
            now = surfaces(scene, t_s + (instant + 0.5) / s**2 * 1e-6 * optics.exposure_us, stage)
            lattice = _Lattice(1.0, (j + 0.5) / s - 0.5, (i + 0.5) / s - 0.5, rows, columns)
            rays[i::s, j::s] = _light_at(now, layout, projector, light, optics, camera, lattice)
    return sensor.blurred(rays, optics)


class _Lattice(NamedTuple):
    """Samples at pixel (left + step j, top + step i)."""

    step: float
    left: float
    top: float
    rows: int
    columns: int


def _light_at(
    now: Surfaces,
    layout: RigLayout,
    projector: CameraModel,
    light: NDArray[np.float32],
    optics: Optics,
    camera: CameraModel,
    lattice: _Lattice,
) -> NDArray[np.float32]:
    step, left, top, _, columns = lattice
    lens, lamp = packed(camera), packed(projector)
    shift = np.array(optics.color_shift_px)
    standoff = float(np.linalg.norm(projector.centre - layout.stage_pose()[1]))

    def band(first: int, rows: int) -> NDArray[np.float32]:
        rays = pixel_rays(lens, first, rows, columns, step, left, top)
        hits = now.hits(camera.centre, rays)
        lit = now.visible_from(hits, projector.centre)
        out = shade(now.table, hits.points, hits.normals, hits.which, lit, lamp, light, shift, standoff, optics.ambient)
        now.add_gloss(out, hits, camera.centre, projector.centre)
        now.darken(out, hits, camera.centre, angle_of_a_ray(camera, optics))
        return np.asarray(out.reshape(rows, columns, 3))

    return np.concatenate(in_bands(band, lattice.rows))


def angle_of_a_ray(camera: CameraModel, optics: Optics) -> float:
    """Angle between neighbouring rays, radians."""
    return float(1 / (np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) * optics.supersampling))


def truths(
    layout: RigLayout, scene: Scene, pattern: ColorFringe | None = None, t_s: float = 0.0
) -> tuple[Truth, Truth]:
    """Truth of the left and the right camera at one instant."""
    rig, now = layout.calibration(), surfaces(scene, t_s, layout.stage_pose())

    def of(camera: CameraModel, other: CameraModel) -> Truth:
        def band(first: int, rows: int) -> Truth:
            return rows_of_truth(now, camera, other, rig.projector, pattern, first, rows)

        return stacked(in_bands(band, camera.size[1]))

    return of(rig.left, rig.right), of(rig.right, rig.left)


def in_bands(work: Callable[[int, int], T], rows: int) -> list[T]:
    """``work(first_row, rows)`` for bands of rows, on all cores; the compiled parts release the interpreter lock."""
    firsts = range(0, rows, _BAND_ROWS)
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        return list(pool.map(lambda first: work(first, min(_BAND_ROWS, rows - first)), firsts))
