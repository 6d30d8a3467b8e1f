"""First values of one device from its own marks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.levenberg_marquardt import Fit, fit, residuals
from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.parameterisation import parameterise
from pipeline.calibrate.bundle.adjust.state import INTRINSICS, State, intrinsics_of
from pipeline.calibrate.bundle.initialise.plane_pose import focal_length, pose, shows_front
from pipeline.calibrate.bundle.options import Options
from pipeline.common.errors import CalibrationError
from pipeline.geometry.homography import homography
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_GRID = (0.6, 1.2, 2.4, 4.8, 9.6)
"""Initial focal lengths, in widths of the image: field angles from 80 to 6 degrees."""
_MAX_MARKS = 40
_NO_DISTORTION = ("skew", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_STAGES: tuple[tuple[str, ...], ...] = (_NO_DISTORTION, ("skew", "k2", "p1", "p2", "k3"), ("skew", "p1", "p2", "k3"))


class Mono:
    """One device alone: its intrinsics, and the board's poses in its own frame.

    Attributes:
        state: device 0 with the identity pose, views numbered as everywhere; those without marks stay at identity.
        seen: numbers of the views in which it detected the board.
        front: (views,) whether the board's printed side faced it, by the numbering.
    """

    def __init__(self, state: State, seen: list[int], front: dict[int, bool], rms_px: float) -> None:
        self.state, self.seen, self.front, self.rms_px = state, seen, front, rms_px

    def pose(self, view: int) -> tuple[Array, Array]:
        """(R, t), board to device."""
        return self.state.view_rotations[view], self.state.view_translations[view]


def mono(
    data: Observations,
    points: Array,
    views: int,
    size: tuple[int, int],
    options: Options,
    *,
    name: str,
    start: CameraModel | None = None,
) -> Mono:
    """Calibrate one device from its own marks.

    Without a start the focal length comes from Zhang's closed form with the principal point at the image's centre,
    and from a coarse grid, because the closed form is fragile for long focal lengths; each is adjusted with the centre
    held, the best goes on, and principal point and distortion are freed in stages.

    Args:
        data: the marks of this device alone (its number is ignored).
        points: (n, 3) the board.
        views: how many views there are altogether.
        size: (width, height).
        options: the free parameters.
        name: for messages.
        start: known intrinsics.

    Raises:
        CalibrationError: no image of the device can be used.
    """
    zeros = np.zeros(len(data), dtype=np.int64)
    data = Observations(zeros, data.view, data.mark, data.pixels, data.sigma, data.area, data.ids)
    maps = {view: homography(points[data.mark[where], :2], data.pixels[where])[0] for _, view, where in data.groups()}
    if not maps:
        raise CalibrationError(f"{name}: no view with at least {options.least_marks} marks; show it the whole board")
    front = {view: shows_front(h) for view, h in maps.items()}
    compact = Observations(zeros, _compact(data.view, maps), data.mark, data.pixels, data.sigma, data.area, data.ids)
    compact = _thinned(compact)
    # Rough values, with sigmas that cover what is not modelled yet.
    rough = compact.with_sigma(np.full(len(compact), max(0.5, 5e-4 * size[0])))
    no_offsets = np.zeros((len(compact), 2))
    if start is not None:
        held = parameterise([name], _plain(options), points, 1.0, held=INTRINSICS)
        start_state = _start_state(maps, points, intrinsics_of(start))
        best = fit(start_state, rough, no_offsets, held, loss="cauchy", most_steps=30)
    else:
        best = _search(maps, rough, points, size, options, name)
        for names in _STAGES:
            free = parameterise([name], _plain(options), points, 1.0, held=names)
            tried = fit(best.state, rough, no_offsets, free, loss="cauchy", most_steps=30)
            best = tried if _sane(tried.state, size) else best
    distance = np.linalg.norm(residuals(best.state, compact, no_offsets), axis=1)
    rms = float(np.median(distance)) * 1.2
    rotations, translations = np.tile(np.eye(3), (views, 1, 1)), np.tile([0.0, 0, 1], (views, 1))
    seen = sorted(maps)
    rotations[seen], translations[seen] = best.state.view_rotations, best.state.view_translations
    return Mono(best.state.with_views(rotations, translations), seen, front, rms)


def _thinned(data: Observations) -> Observations:
    """At most :data:`_MAX_MARKS` marks an image, evenly chosen: first values need no more."""
    keep = np.zeros(len(data), dtype=bool)
    for _, _, where in data.groups():
        count = where.stop - where.start
        keep[where.start + np.unique(np.linspace(0, count - 1, min(count, _MAX_MARKS)).astype(int))] = True
    return data.some(keep)


def _plain(options: Options) -> Options:
    return Options(aspect=options.aspect)


def _compact(view: Index, maps: dict[int, Array]) -> Index:
    return np.searchsorted(np.array(sorted(maps)), view).astype(np.int64)


def _start_state(maps: dict[int, Array], points: Array, intrinsics: Array) -> State:
    fx, fy, skew, cx, cy = intrinsics[:5]
    matrix = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
    poses = [pose(maps[view], matrix) for view in sorted(maps)]
    rotations, translations = np.stack([r for r, _ in poses]), np.stack([t for _, t in poses])
    return State(intrinsics[None], np.eye(3)[None], np.zeros((1, 3)), rotations, translations, points)


def _search(
    maps: dict[int, Array], data: Observations, points: Array, size: tuple[int, int], options: Options, name: str
) -> Fit:
    """The best adjustment with one focal length and nothing else, over several first focal lengths."""
    centre = (np.array(size, np.float64) - 1) / 2
    closed = focal_length(list(maps.values()), centre)
    grid = [closed] if 0.2 * size[0] < closed < 40 * size[0] else []
    grid += [share * size[0] for share in _GRID]
    only = Options(aspect=options.aspect or 1.0)
    free = parameterise([name], only, points, 1.0, held=_NO_DISTORTION)
    best: Fit | None = None
    no_offsets = np.zeros((len(data), 2))
    for focal in grid:
        first = np.array([focal, focal * (options.aspect or 1.0), 0, *centre, 0, 0, 0, 0, 0])
        tried = fit(_start_state(maps, points, first), data, no_offsets, free, loss="cauchy", most_steps=25)
        if np.isfinite(tried.cost) and _sane(tried.state, size) and (best is None or tried.cost < best.cost):
            best = tried
        if best is tried and focal == closed and _plausible(tried.state, data, size):
            break
    if best is None:
        raise CalibrationError(
            f"{name}: no focal length between 0.2 and 40 image widths explains the views; are board, numbering and "
            "image size right? Show the board tilted by 20 to 40 degrees"
        )
    return best


def _plausible(state: State, data: Observations, size: tuple[int, int]) -> bool:
    """Whether the residuals are small enough to come from the distortion alone."""
    distance = np.linalg.norm(residuals(state, data, np.zeros((len(data), 2))), axis=1)
    return bool(np.median(distance) < 2e-3 * size[0])


def _sane(state: State, size: tuple[int, int]) -> bool:
    fx, fy, _, cx, cy = state.intrinsics[0, :5]
    width, height = size
    inside = -0.25 * width < cx < 1.25 * width and -0.25 * height < cy < 1.25 * height
    return bool(0.15 * width < fx < 60 * width and 0.15 * width < fy < 60 * width and inside)
