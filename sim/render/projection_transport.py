"""Light transport from projector to cameras for a scene at rest: computed once, then applied to any projected image.

Light is linear: each ray of a camera image meets one position of the projector image and returns a fixed fraction of
its light. A new image costs one look-up per ray; the rest (lens blur, colours, mosaic, noise) is the renderer's code.
The results differ from those of :mod:`sim.render.render_pair` by rounding only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.rig.camera_model import CameraModel
from sim.render import render_pair, sensor
from sim.render.lens import packed, pixel_rays, pixels_of
from sim.render.projected_light import projected_light, shade
from sim.render.render_pair import Image
from sim.rig.disturbance import TrueRig
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.ray_hits import Surfaces, surfaces
from sim.scene.scene import Scene

Light = NDArray[np.float32]
Counts = tuple[Light, Light]

# Pixels added to the projector image at each edge, so that no look-up needs clamping.
_EDGE_PX = 2


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Where each ray of one camera meets the projector image during one exposure, and how much light returns.

    Args:
        uv: (H s, W s, 2) float32, projector pixel, for s x s rays a pixel.
        gain: (H s, W s, 3) float32, light that returns per light sent, R G B; 0 in shadow and outside the image.
        dark: (H, W, 3) float32, light on the sensor while the projector is black.
    """

    uv: Light
    gain: Light
    dark: Light

    def lit_by(self, light: Light, optics: Optics) -> Light:
        """Light on the sensor, (H, W, 3), under ``light`` of :func:`sim.render.projected_light.projected_light`."""
        edged = cv2.copyMakeBorder(light, _EDGE_PX, _EDGE_PX, _EDGE_PX, _EDGE_PX, cv2.BORDER_REPLICATE)
        rays = np.empty_like(self.gain)
        shifts = np.asarray(optics.color_shift_px, dtype=np.float32)
        groups = [(0, 3)] if (shifts == shifts[0]).all() else [(0, 1), (1, 2), (2, 3)]

        def band(first: int, rows: int) -> None:
            some = slice(first, first + rows)
            for start, end in groups:
                _reflected(self.uv[some], self.gain[some], edged, shifts[start], start, end, rays[some])

        render_pair.in_bands(band, len(rays))
        return _pixels(rays, optics) + self.dark


class Stage:
    """A scene at fixed instants, for any projected image.

    It keeps 20 bytes a ray, camera and instant: 70 MB a camera at 1024 x 820, 4 MB at a quarter of that size.

    Args:
        layout, scene, optics, encoding: as :func:`sim.render.render_pair.render_pair` takes them.
        instants_s: starts of exposure in the scene's time; one is enough for a scene at rest.
        rig: a disturbed rig instead of that of the layout and the optics.
        like: a stage of the same layout, scene, optics and instants; the rays of a camera that stands there as here,
            before a projector that does, are taken from it.
    """

    def __init__(
        self,
        layout: RigLayout,
        scene: Scene,
        optics: Optics | None = None,
        *,
        encoding: str = "rgb8",
        instants_s: tuple[float, ...] = (0.0,),
        rig: TrueRig | None = None,
        like: Stage | None = None,
    ) -> None:
        if not instants_s:
            raise ValueError("instants_s is empty, expected at least one instant")
        if encoding not in sensor.ENCODINGS:
            raise ValueError(f"encoding is {encoding!r}, expected one of {', '.join(sensor.ENCODINGS)}")
        self.layout, self.scene, self.optics, self.encoding = layout, scene, optics or Optics(), encoding
        self.instants_s = instants_s if scene.moves else instants_s[:1]
        self.rig = rig = TrueRig.of(layout, self.optics) if rig is None else rig
        known = {} if like is None else like._footprints
        self._footprints: dict[tuple[object, ...], Footprint] = {}
        for t_s in self.instants_s:
            for camera in (rig.left, rig.right):
                key = _key(t_s, rig.projector, camera)
                found = known.get(key)
                self._footprints[key] = found or _footprint(layout, rig.projector, scene, self.optics, t_s, camera)

    def counts(self, image: NDArray[np.uint8], instant: int = 0) -> Counts:
        """Counts above black of both cameras without noise, as of :func:`sim.render.render_pair.render_counts`.

        Args:
            image: (H, W, 3) uint8 of the projector's size.
            instant: index of ``instants_s``, modulo their number.
        """
        sent = render_pair.image_sent(image, self.optics, self.layout.projector_size)
        light = projected_light(sent, self.optics)
        t_s = self.instants_s[instant % len(self.instants_s)]
        left, right = (
            sensor.exposed(
                self._footprints[_key(t_s, self.rig.projector, device)].lit_by(light, self.optics),
                camera,
                self.optics,
                self.encoding,
                self.rig.crosstalk[camera],
            )
            for camera, device in enumerate((self.rig.left, self.rig.right))
        )
        return left, right

    def images(self, counts: Counts, seed: int) -> tuple[Image, Image]:
        """Both images of counts; the seed determines the noise."""
        return render_pair.with_noise(counts, self.optics, seed, self.encoding)


def _key(t_s: float, projector: CameraModel, camera: CameraModel) -> tuple[object, ...]:
    """All that a footprint depends on in one scene under one light."""
    devices = projector, camera
    arrays = (part for one in devices for part in (one.matrix, one.distortion, one.rotation, one.translation))
    return t_s, *(part.tobytes() for part in arrays)


def _footprint(
    layout: RigLayout, projector: CameraModel, scene: Scene, optics: Optics, t_s: float, camera: CameraModel
) -> Footprint:
    """The rays of :func:`sim.render.render_pair.light_on_sensor`, kept instead of lit."""
    s, (columns, rows) = optics.supersampling, camera.size
    uv = np.empty((rows * s, columns * s, 2), np.float32)
    gain, dark = np.empty((rows * s, columns * s, 3), np.float32), np.empty((rows * s, columns * s, 3), np.float32)
    for i in range(s):
        for j in range(s):
            instant = (s * i + (j if i % 2 == 0 else s - 1 - j) + 0.5) / s**2 if scene.moves else 0.0
            now = surfaces(scene, t_s + instant * 1e-6 * optics.exposure_us, layout.stage_pose())
            some = np.s_[i::s, j::s]
            offset = (j + 0.5) / s - 0.5, (i + 0.5) / s - 0.5
            uv[some], gain[some], dark[some] = _sampled(now, layout, projector, optics, camera, offset)
    return Footprint(uv, gain, _pixels(dark, optics))


def _pixels(rays: Light, optics: Optics) -> Light:
    """:func:`sim.render.sensor.blurred` with the mean over each pixel's rays taken in a quarter of the time."""
    s = optics.supersampling
    blurred = sensor.blurred(rays, replace(optics, supersampling=1, psf_px=optics.psf_px * s))
    rows, columns = rays.shape[0] // s, rays.shape[1] // s
    return np.asarray(cv2.resize(blurred, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _sampled(
    now: Surfaces,
    layout: RigLayout,
    projector: CameraModel,
    optics: Optics,
    camera: CameraModel,
    offset: tuple[float, float],
) -> tuple[Light, Light, Light]:
    """One ray a pixel: projector pixel (H, W, 2), gain (H, W, 3), and light under a black image (H, W, 3)."""
    columns, rows = camera.size
    lamp = packed(projector)
    shift = np.array(optics.color_shift_px)
    standoff = float(np.linalg.norm(projector.centre - layout.stage_pose()[1]))
    unit = np.ones((projector.size[1], projector.size[0], 3), np.float32)
    black = np.zeros((1, 1, 3), np.float32)

    def band(first: int, height: int) -> tuple[Light, Light, Light]:
        hits = now.hits(camera.centre, pixel_rays(packed(camera), first, height, columns, 1.0, *offset))
        lit = now.visible_from(hits, projector.centre)
        surface = (now.table, hits.points, hits.normals, hits.which)
        # The renderer's own shading under a light of one everywhere is the share of light that comes back.
        gain = shade(*surface, lit, lamp, unit, shift, standoff, 0.0)
        dark = shade(*surface, np.zeros_like(lit), lamp, black, shift, standoff, optics.ambient)
        for part in (gain, dark):
            now.add_gloss(part, hits, camera.centre, projector.centre)
            now.darken(part, hits, camera.centre, render_pair.angle_of_a_ray(camera, optics))
        uv = np.where(lit[:, None], pixels_of(lamp, hits.points), 0.0).astype(np.float32)
        return tuple(part.reshape(height, columns, -1) for part in (uv, gain, dark))  # type: ignore[return-value]

    bands = render_pair.in_bands(band, rows)
    uv, gain, dark = (np.concatenate([part[k] for part in bands]) for k in range(3))
    return uv, gain, dark


@njit(cache=True, nogil=True, fastmath=True)
def _reflected(uv: Light, gain: Light, light: Light, shift: np.float32, first: int, last: int, out: Light) -> None:
    """Light that each ray returns in channels first .. last; ``light`` has ``_EDGE_PX`` more pixels at each edge."""
    half, most = np.float32(0.5), np.float32(0.75)
    for row in range(uv.shape[0]):
        for column in range(uv.shape[1]):
            bright = False
            for c in range(first, last):
                bright |= gain[row, column, c] > 0
            if not bright:
                for c in range(first, last):
                    out[row, column, c] = 0
                continue
            u, v = uv[row, column, 0] - shift, uv[row, column, 1]
            j, i = int(np.floor(u + half)), int(np.floor(v + half))
            fu, fv = u - np.float32(j), v - np.float32(i)
            u0, u1, u2 = half * (half - fu) ** 2, most - fu * fu, half * (half + fu) ** 2
            v0, v1, v2 = half * (half - fv) ** 2, most - fv * fv, half * (half + fv) ** 2
            j += _EDGE_PX - 1
            i += _EDGE_PX - 1
            for c in range(first, last):
                above = u0 * light[i, j, c] + u1 * light[i, j + 1, c] + u2 * light[i, j + 2, c]
                middle = u0 * light[i + 1, j, c] + u1 * light[i + 1, j + 1, c] + u2 * light[i + 1, j + 2, c]
                below = u0 * light[i + 2, j, c] + u1 * light[i + 2, j + 1, c] + u2 * light[i + 2, j + 2, c]
                out[row, column, c] = gain[row, column, c] * (v0 * above + v1 * middle + v2 * below)
