"""Logging to Rerun: entities, timelines, units.

    world/cloud                      points, mm, in the left camera's frame (x right, y down, z forward)
    images/left, right, modulation   the images of ``preview``, BGR
    figures/rate_hz, latency_ms, points, drops, ...   one number each

Timelines: ``exposure`` (time of the start of exposure) and ``cloud`` (its number).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.viewer.colors import packed
from daemon.apps.viewer.layout import CLOUD, IMAGES, Extent, blueprint
from daemon.apps.viewer.rerun_import import rerun

_FILL = 0.9  # radius of a point relative to the distance of its neighbour: closes the surface, keeps real holes visible
_DEFAULT_RADIUS_MM = 0.5


class Logger:
    """Logs measurements of the live viewer and of replays.

    Args:
        recording: a ``rerun.RecordingStream``; the layout is sent to it with the first cloud.
        decimate: stride of the rows and columns; color: the quantity that the colours encode, see ``colors.COLORS``.
    """

    def __init__(self, recording: Any, *, decimate: int = 2, color: str = "depth") -> None:
        self._rr, self._recording = rerun(), recording
        self._step, self._color = slice(None, None, decimate), color
        self._positioned = False
        recording.send_blueprint(blueprint())
        recording.log("world", self._rr.ViewCoordinates.RDF, static=True)

    def time(self, *, t_ns: int, seq: int | None = None) -> None:
        """Set the timelines of the next entries: start of exposure, number of the cloud."""
        if seq is not None:
            self._recording.set_time("cloud", sequence=seq)
        self._recording.set_time("exposure", timestamp=np.datetime64(t_ns, "ns"))

    def cloud(
        self,
        xyz: NDArray[np.float32],
        gray: NDArray[np.uint8],
        sigma: NDArray[np.float32],
        rgb: NDArray[np.uint8] | None = None,
    ) -> None:
        """Log a cloud: (H, W, 3) mm, NaN where invalid; (H, W) texture; (H, W) sigma, mm; (H, W, 3) colour."""
        self._position_eye(xyz)
        step = self._step
        points, valid = xyz[step, step], np.isfinite(xyz[step, step, 2])
        # Selection by a mask copies: Rerun keeps a reference to the positions, so they must not change.
        positions = points[valid]
        colors = packed(
            self._color, z=positions[:, 2], gray=gray[step, step][valid], sigma=sigma[step, step][valid],
            rgb=None if rgb is None else rgb[step, step][valid],
        )  # fmt: skip
        self._recording.log(CLOUD, self._rr.Points3D(positions, colors=colors, radii=[_FILL * _pitch_mm(points)]))

    def images(self, jpegs: Mapping[str, NDArray[np.uint8]]) -> None:
        """Log the JPEG files of a ``preview`` message by name; damaged ones are left out."""
        for part, name in IMAGES.items():
            if part in jpegs and (image := _decode(jpegs[part], half=self._step.step > 1)) is not None:
                self._recording.log(f"images/{name}", self._rr.Image(image, color_model="BGR"))

    def figures(self, values: Mapping[str, float]) -> None:
        """Log numbers for the plots, by name."""
        for name, value in values.items():
            self._recording.log(f"figures/{name}", self._rr.Scalars(value))

    def _position_eye(self, xyz: NDArray[np.float32]) -> None:
        """Place the eye in front of the first cloud; afterwards the user moves it."""
        if not self._positioned and (region := extent(xyz)) is not None:
            self._recording.send_blueprint(blueprint(region))
            self._positioned = True


def extent(xyz: NDArray[np.float32]) -> Extent | None:
    """The extent of a cloud, (H, W, 3) mm; None with fewer than eight points."""
    coarse = xyz[::4, ::4].reshape(-1, 3)
    points = coarse[np.isfinite(coarse[:, 2])]
    if len(points) < 8:
        return None
    low, high = np.percentile(points, (2.0, 98.0), axis=0)
    x, y, z = ((low + high) / 2).tolist()
    a, b, c = ((high - low) / 2).tolist()
    return Extent((x, y, z), (a, b, c))


def _decode(jpeg: NDArray[np.uint8], *, half: bool) -> NDArray[Any] | None:
    """Decode to (H, W, 3) BGR, or half of that size.

    The viewer treats a series of JPEG files as a video that restarts with each file, and shows none of them live.
    """
    import cv2

    if not jpeg.size:
        return None
    return cv2.imdecode(jpeg, cv2.IMREAD_REDUCED_COLOR_2 if half else cv2.IMREAD_COLOR)


def _pitch_mm(points: NDArray[np.float32]) -> float:
    """Median distance of neighbours in a row."""
    rows = points[:: max(1, len(points) // 32), :, 0]
    gaps = np.abs(np.diff(rows, axis=1))
    gaps = gaps[np.isfinite(gaps)]
    return float(np.median(gaps)) if len(gaps) else _DEFAULT_RADIUS_MM / _FILL
