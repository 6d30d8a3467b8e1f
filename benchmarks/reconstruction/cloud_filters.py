"""Time of each cloud filter and optional part at full size: ``python -m benchmarks.reconstruction.cloud_filters``.

A tilted plane with noise; a quarter of the image is unknown, mostly in two patches, a hundredth in single pixels.
Processor time of one thread, so that other programs on the machine do not count; of the parts wall time, too, with all
threads.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numba
import numpy as np

from daemon.cli.allocator import prepare
from pipeline.common.settings import Settings
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import cloud_filters
from pipeline.reconstruct.optional_parts import NORMALS, RGB, with_parts
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.pose import Pose
from sim.rig.layout import RigLayout

SIGMA_MM = 0.03
CASES: dict[str, dict[str, Any]] = {
    "temporal fusion": {"fuse": True},
    "noise": {"noise_threshold_mm": 1.0},
    "outlier, 5 mm": {"outlier_threshold_mm": 5.0},
    "smoothing, 0.5 px": {"smoothing_sigma_px": 0.5},
    "smoothing, 1 px": {"smoothing_sigma_px": 1.0},
    "hole filling, 4 px": {"hole_filling_size": 4},
    "hole filling, 16 px": {"hole_filling_size": 16},
    "region of interest": {"roi_row_max": 800},
    "downsampling, 2 x 2": {"downsampling": 2},
    "downsampling, 4 x 4": {"downsampling": 4},
    "output frame": {"pose": Pose(np.eye(3), np.ones(3), "table")},
}


def main() -> None:
    """Print a line for each filter and part."""
    prepare()
    numba.set_num_threads(1)
    layout = RigLayout()
    calibration = layout.calibration()
    rays = calibration.left.rays()
    height, width = rays.shape[:2]
    rng = np.random.default_rng(0)
    z = 1400 / (1 - rays @ np.array([0.3, 0.2])) + SIGMA_MM * rng.standard_normal((height, width))
    z[:, : width // 8] = z[height // 3 : 7 * height // 12, width // 2 :] = np.nan
    z[rng.random(z.shape) < 0.01] = np.nan
    xyz = (np.concatenate([rays, np.ones((height, width, 1))], axis=-1) * z[..., None]).astype(np.float32)
    sigma = np.where(np.isnan(z), np.nan, SIGMA_MM).astype(np.float32)
    gray = np.full(z.shape, 80, np.uint8)
    cloud = Cloud(xyz, sigma, gray, (gray, gray), np.zeros(z.shape, np.int16))
    print(f"{width} x {height} pixels, {np.isfinite(sigma).mean():.0%} known")
    for name, case in CASES.items():
        options = {key: case[key] for key in ("pose", "fuse") if key in case}
        settings = Settings(**{key: value for key, value in case.items() if key not in options})
        filters = cloud_filters(calibration, settings, mosaic=False, **options)
        assert filters is not None
        print(f"{name:24s}{milliseconds(partial(filters.apply, cloud)):8.1f} ms")
    reconstructor = Reconstructor(calibration, layout.pattern(), layout.volume())
    image = rng.integers(20, 220, (height, width, 3), dtype=np.uint8)
    for part in (RGB, NORMALS):
        add = partial(with_parts, cloud, reconstructor, image, (part,))
        numba.set_num_threads(1)
        one = milliseconds(add)
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
        print(f"{part:24s}{one:8.1f} ms, with all threads {milliseconds(add, time.perf_counter):.1f} ms")


def milliseconds(work: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Median of some calls, after one that compiles."""
    work()
    times = []
    for _ in range(15):
        began = clock()
        work()
        times.append(1e3 * (clock() - began))
    return median(times)


if __name__ == "__main__":
    main()
