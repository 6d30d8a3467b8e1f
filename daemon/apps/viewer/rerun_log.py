"""What is logged to Rerun: entities, timelines, units.

    world/cloud                      points, mm, in the left camera's frame (x right, y down, z forward)
    images/left, right, modulation the images of ``preview``, BGR
    figures/rate_hz, latency_ms, points, drops, ... one number each

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

_FILL = 0.9  # radius of a point as a part of the distance to its neighbour: closes the surface, hides no real hole
_DEFAULT_RADIUS_MM = 0.5


class Logger:
    """Logs what was measured; the live viewer and a replay look the same because both log here.

    Args:
        recording: a ``rerun.RecordingStream``; the layout is sent to it with the first cloud.
        decimate: show every so many rows and columns; color: what the colours show, see ``colors.COLORS``.
    """

    def __init__(self, recording: Any, *, decimate: int = 2, color: str = "depth") -> None:
        self._rr, self._recording = rerun(), recording
        self._step, self._color = slice(None, None, decimate), color
        self._placed = False
        recording.send_blueprint(blueprint())
        recording.log("world", self._rr.ViewCoordinates.RDF, static=True)

    def time(self, *, t_ns: int, seq: int | None = None) -> None:
        """Set the timelines for what is logged next: start of exposure, number of the cloud."""
        if seq is not None:
            self._recording.set_time("cloud", sequence=seq)
        self._recording.set_time("exposure", timestamp=np.datetime64(t_ns, "ns"))

    def cloud(self, xyz: NDArray[np.float32], gray: NDArray[np.uint8], sigma: NDArray[np.float32]) -> None:
        """Log a cloud: (H, W, 3) mm, NaN where unknown; (H, W) texture; (H, W) standard deviation, mm."""
        self._place(xyz)
        step = self._step
        points, known = xyz[step, step], np.isfinite(xyz[step, step, 2])
        # Selecting by a mask copies: Rerun keeps a reference to the positions, so they must be nobody else's.
        positions = points[known]
        colors = packed(self._color, z=positions[:, 2], gray=gray[step, step][known], sigma=sigma[step, step][known])
        self._recording.log(CLOUD, self._rr.Points3D(positions, colors=colors, radii=[_FILL * _pitch_mm(points)]))

    def images(self, jpegs: Mapping[str, NDArray[np.uint8]]) -> None:
        """Log JPEG files by the names that they have in a ``preview`` message; one that is damaged is passed over."""
        for part, name in IMAGES.items():
            if part in jpegs and (image := _decoded(jpegs[part], half=self._step.step > 1)) is not None:
                self._recording.log(f"images/{name}", self._rr.Image(image, color_model="BGR"))

    def figures(self, values: Mapping[str, float]) -> None:
        """Log numbers for the plots, by name."""
        for name, value in values.items():
            self._recording.log(f"figures/{name}", self._rr.Scalars(value))

    def _place(self, xyz: NDArray[np.float32]) -> None:
        """Put the eye before the first cloud; afterwards it belongs to who looks."""
        if not self._placed and (where := extent(xyz)) is not None:
            self._recording.send_blueprint(blueprint(where))
            self._placed = True


def extent(xyz: NDArray[np.float32]) -> Extent | None:
    """Where a cloud lies, (H, W, 3) mm; None if it has hardly any points."""
    coarse = xyz[::4, ::4].reshape(-1, 3)
    points = coarse[np.isfinite(coarse[:, 2])]
    if len(points) < 8:
        return None
    low, high = np.percentile(points, (2.0, 98.0), axis=0)
    x, y, z = ((low + high) / 2).tolist()
    a, b, c = ((high - low) / 2).tolist()
    return Extent((x, y, z), (a, b, c))


def _decoded(jpeg: NDArray[np.uint8], *, half: bool) -> NDArray[Any] | None:
    """(H, W, 3) BGR, or half of that size.

    The viewer could decode as well, but takes a series of JPEG files for a video that starts anew with each of them,
    and live it never gets as far as showing one.
    """
    import cv2

    if not jpeg.size:
        return None
    return cv2.imdecode(jpeg, cv2.IMREAD_REDUCED_COLOR_2 if half else cv2.IMREAD_COLOR)


def _pitch_mm(points: NDArray[np.float32]) -> float:
    """Usual distance of neighbours in a row."""
    rows = points[:: max(1, len(points) // 32), :, 0]
    gaps = np.abs(np.diff(rows, axis=1))
    gaps = gaps[np.isfinite(gaps)]
    return float(np.median(gaps)) if len(gaps) else _DEFAULT_RADIUS_MM / _FILL
