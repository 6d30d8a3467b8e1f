"""The kernels of the reconstruction in parts that separate processes can compile.

Each part runs some stages on a small rig and on phase maps of zeros. numba compiles a kernel for the types of its
arguments, whatever their values and sizes are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from pipeline.attributes.normals import normals_of
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.decode.decoder import PhaseMap
from pipeline.filter.occlusion.kernel_warmup import warm_up_conflicts
from pipeline.filter.texture_agreement import Scale
from pipeline.fringe_order.left_right_check import cross_check
from pipeline.fringe_order.margins.order_margins import Continued, Limits
from pipeline.fringe_order.order_propagation import propagate
from pipeline.match.match_result import MatchResult, Points
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud_filters import cloud_filters
from pipeline.reconstruct.orders_to_cloud import CertainPoints
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.pose import Pose
from pipeline.rig.volume import Volume

WIDTH, HEIGHT = 96, 80
_SCALE = Scale(0.0, 0.02, 0.0, 0.04, 0.0, 0.0)
_FILTERED = Settings(
    noise_threshold_mm=1.0, outlier_threshold_mm=1.0, smoothing_sigma_px=1.0, hole_filling_size=3, downsampling=2,
    roi_z_max_mm=2000.0,
)  # fmt: skip
"""Every filter of the finished cloud is on."""


def small_rig() -> tuple[Calibration, ColorFringe, Volume]:
    """Two cameras and a projector between them, with images of WIDTH x HEIGHT pixels."""

    def device(name: str, x_mm: float) -> CameraModel:
        matrix = np.array([[150.0, 0.0, WIDTH / 2], [0.0, 150.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
        return CameraModel((WIDTH, HEIGHT), matrix, translation=np.array([-x_mm, 0.0, 0.0]), name=name)

    calibration = Calibration(device("left", 0.0), device("right", 200.0), device("projector", 90.0))
    return calibration, ColorFringe((WIDTH, HEIGHT), 6.0), Volume(1000.0, 1400.0)


@cache
def small_reconstructor(encoding: str) -> Reconstructor:
    """A reconstructor for that rig, not warmed up."""
    return Reconstructor(*small_rig(), encoding=encoding)


def parts(encoding: str) -> dict[str, Callable[[], None]]:
    """Functions that compile the kernels of a pair, by names; those that take longest first.

    Args:
        encoding: of the images; only the first part depends on it, and so does its name.
    """
    kind = "rgb8" if encoding == "rgb8" else "mosaic"
    return {
        f"decode {kind}": lambda: _decode("rgb8" if kind == "rgb8" else "bayer_rggb8"),
        "match": _match,
        "order search": _search,
        "uniqueness": warm_up_conflicts,
        "filter": _filter,
        "check and propagation": _check,
        "output": _output,
        "normals": _normals,
    }


def compile_cloud_filters() -> None:
    """Compile (or load) the kernels of the filters of the finished cloud, which are off until they are asked for."""
    cloud_filters(small_rig()[0], _FILTERED, mosaic=False, pose=Pose(), fuse=True)


def _decode(encoding: str) -> None:
    deep = (3,) if encoding == "rgb8" else ()
    image = np.random.default_rng(0).integers(40, 200, (HEIGHT, WIDTH, *deep), np.uint8)
    decoder = small_reconstructor(encoding).decoders[0]
    decoder.correct(np.full(6, 1e-3))  # of the first pair, where that has a periodic error
    decoder.decode(image, decoder.cast(image))
    decoder.color(image)


def _normals() -> None:
    normals_of(np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.float32))


def _phase_map() -> PhaseMap:
    shape = HEIGHT, WIDTH
    return PhaseMap(
        np.zeros(shape, np.int32), np.zeros(shape, np.int32), np.zeros(shape, np.uint8), np.ones(shape, np.float32),
        0.0, np.zeros(shape, np.float32), np.zeros(shape, np.uint8), np.ones(shape, np.bool_),
        np.zeros(shape, np.uint8),
    )  # fmt: skip


def _search() -> None:
    made, phases = small_reconstructor("rgb8"), _phase_map()
    search = made.searches[0]
    search.search(phases, phases, made.correction, use_prior=True)
    search.set_prior(phases, np.zeros(made.left.table.shape, np.int16))
    search.search(phases, phases, made.correction, use_prior=True)
    label, valid = np.ones((HEIGHT, WIDTH), np.uint16), np.ones((HEIGHT, WIDTH), np.uint8)
    sizes, order = np.full(1, label.size, np.int32), np.zeros(label.shape, np.int16)
    limits = Limits(0.1, np.zeros(1))
    search.reject_ambiguous(phases, phases, made.correction, limits, order, 1, label, sizes, Continued.none(1), valid)


def _check() -> None:
    made, phases = small_reconstructor("rgb8"), _phase_map()
    left, right = made.left, made.right
    order, other = np.zeros(left.table.shape, np.int16), np.zeros(right.table.shape, np.int16)
    place = np.empty(order.shape, np.int32)
    cross_check(left, phases, order, right, phases, other, made.correction, np.empty_like(order), place)
    made.searches[0].reject_unseen(phases, phases, made.correction, right, place, order)
    made.searches[0].reject_contradicted(phases, phases, made.correction, right, order)
    propagate(left, phases, order, np.empty((HEIGHT, WIDTH), np.int16))


def _match() -> None:
    made, phases = small_reconstructor("rgb8"), _phase_map()
    points, order = Points.empty((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH), np.int16)
    stage = made.stage(1)
    stage.match(phases, phases, order, made.correction, points)
    stage.match_neighbours(phases, phases, order, _SCALE, _SCALE, made.correction, points)


def _filter() -> None:
    made, phases = small_reconstructor("rgb8"), _phase_map()
    order = np.zeros((HEIGHT, WIDTH), np.int16)
    for stride in (1, 2):
        made.stage(stride).certain(phases, phases, order, made.correction, Stopwatch(None))


def _output() -> None:
    made, phases, points = small_reconstructor("rgb8"), _phase_map(), Points.empty((HEIGHT, WIDTH))
    for stride in (1, 2):
        part, shape = phases.subsampled(stride) if stride > 1 else phases, (HEIGHT // stride, WIDTH // stride)
        match, order, valid = MatchResult.empty(shape), np.zeros(shape, np.int16), np.zeros(shape, np.uint8)
        match.valid[:] = 0
        made.stage(stride).finish(phases, phases, CertainPoints(part, order, match, points, valid), Stopwatch(None))
