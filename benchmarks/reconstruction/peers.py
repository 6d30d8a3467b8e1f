"""Other programs on the same pair of images; runs in the peers' own environment, imports nothing of this project.

``python peers.py PAIR.npz RESULT.npz REPEATS THREADS [quick]`` reads images and rig, writes each peer's result and a
JSON text with the calls and their times. :mod:`benchmarks.reconstruction.compare` scores them.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import cv2 as opencv
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
cv2: Any = opencv  # with the contributed modules, which no types describe
_SECONDS = 12.0


class Pair:
    """Both images and the rig, as arrays; see :func:`benchmarks.reconstruction.compare.written`."""

    def __init__(self, file: str) -> None:
        with np.load(file) as arrays:
            self.values = dict(arrays)
        self.left, self.right = self.values["left"], self.values["right"]
        self.size = (self.left.shape[1], self.left.shape[0])
        self.periods = int(self.values["periods"])
        self.projector = tuple(int(n) for n in self.values["projector"])
        self.near, self.far = (float(v) for v in self.values["volume"])


def timed(call: Callable[[], Any], repeats: int, *, warm: bool = True) -> tuple[Any, list[float]]:
    """The call's result, and milliseconds of each of some runs, after one that is not counted if ``warm``."""
    result = call() if warm else None
    begin = time.perf_counter()
    ms: list[float] = []
    while len(ms) < repeats and (len(ms) < 3 or time.perf_counter() - begin < _SECONDS):
        start = time.perf_counter()
        result = call()
        ms.append(1e3 * (time.perf_counter() - start))
    return result, ms


def fringes(pair: Pair, repeats: int, *, quick: bool) -> list[dict[str, Any]]:
    """Wavelength-division multiplexing: three shifts in one colour image; one frequency, so unwrapped spatially."""
    logging.disable(logging.ERROR)  # it warns at every call that the phase is only relative
    import fringes.fringes as module

    width, height = pair.projector
    f = module.Fringes(X=width, Y=height, axes=1, K=1, N=3, v=pair.periods, WDM=True, reverse=True)
    if f.T != 1 or f.uwr != "spatial":
        raise RuntimeError(f"fringes took other options: {f.T} images, unwrapping {f.uwr}")
    spent_ms = [0.0]
    plain = module.spu

    def unwrap(*args: Any, **options: Any) -> Array:
        start = time.perf_counter()
        result: Array = plain(*args, **options)
        spent_ms[0] += 1e3 * (time.perf_counter() - start)
        return result

    module.spu = unwrap
    rows = []
    # Its other unwrapping takes a quarter of a minute on such images: once is enough.
    for name, option, runs in (("scikit-image", "ski", repeats), ("OpenCV", "cv2", 1))[: 1 if quick else 2]:
        unwrapping: list[float] = []

        def both(option: str = option, unwrapping: list[float] = unwrapping) -> list[Any]:
            spent_ms[0] = 0.0
            found = [f.decode(image, spu_func=option) for image in (pair.left, pair.right)]
            unwrapping.append(spent_ms[0])
            return found

        found, ms = timed(both, runs, warm=runs > 1)
        rows.append(
            {
                "name": f"fringes {version('fringes')}, {name}",
                "called": f"Fringes(K=1, N=3, WDM=True).decode(image, spu_func='{option}')",
                "key": f"fringes_{option}",
                "gives": "relative phase",
                "ms": ms,
                "unwrapping_ms": unwrapping[-len(ms) :],
                "absolute": found[0].x[0, ..., 0] * (2 * np.pi / float(f.l.ravel()[0])),
            }
        )
    return rows


def opencv_phase(pair: Pair, repeats: int, *, quick: bool) -> list[dict[str, Any]]:
    """``structured_light.SinusoidalPattern`` with the three channels as its three images.

    Its Fourier step pads to a size that suits it but masks and shifts the unpadded one, reading past the end of the
    mask (and PSP then fails an assertion): so the images are padded here, beforehand.
    """
    height, width = pair.left.shape[:2]
    down, across = (cv2.getOptimalDFTSize(n) - n for n in (height, width))
    channels = [
        [np.ascontiguousarray(c) for c in cv2.split(cv2.copyMakeBorder(p, 0, down, 0, across, cv2.BORDER_CONSTANT))]
        for p in (pair.left, pair.right)
    ]
    size = channels[0][0].shape[::-1]
    rows = []
    for method in ("FTP", "PSP", "FAPS")[: 2 if quick else 3]:
        options = cv2.structured_light_SinusoidalPattern_Params()
        options.width, options.height = pair.projector
        options.nbrOfPeriods, options.shiftValue = pair.periods, 2 * np.pi / 3
        options.methodId = getattr(cv2.structured_light, method)
        options.horizontal = options.setMarkers = False
        pattern = cv2.structured_light_SinusoidalPattern.create(options)

        def both(pattern: Any = pattern) -> list[Array]:
            unwrapped = []
            for images in channels:
                wrapped, mask = pattern.computePhaseMap(images)
                unwrapped.append(pattern.unwrapPhaseMap(wrapped, size, None, mask))
            return unwrapped

        found, ms = timed(both, repeats)
        rows.append(
            {
                "name": f"OpenCV {cv2.__version__} SinusoidalPattern {method}",
                "called": "computePhaseMap + unwrapPhaseMap",
                "key": method,
                "gives": "relative phase",
                "ms": ms,
                "absolute": found[0][:height, :width],
            }
        )
    return rows


def stereo(pair: Pair, repeats: int, *, quick: bool) -> list[dict[str, Any]]:
    """Semi-global block matching of the rectified colour images: the usual method without fringes."""
    v = pair.values
    left, right = (v["left_matrix"], v["left_distortion"]), (v["right_matrix"], v["right_distortion"])
    # flags=0: the axes converge, so a common principal point would shift both images out of view.
    r1, r2, p1, p2, q, *_ = cv2.stereoRectify(
        *left, *right, pair.size, v["rotation"], v["translation"].reshape(3, 1), flags=0, alpha=-1
    )
    maps = [
        cv2.initUndistortRectifyMap(*camera, r, p, pair.size, cv2.CV_16SC2)
        for camera, r, p in ((left, r1, p1), (right, r2, p2))
    ]
    first, count = disparities(pair, r1, p1, p2)
    rows = []
    modes = (("3WAY", cv2.STEREO_SGBM_MODE_SGBM_3WAY), ("HH", cv2.STEREO_SGBM_MODE_HH))
    for name, mode in modes[: 1 if quick else 2]:
        block, channels = 5, 3
        matcher = cv2.StereoSGBM_create(
            minDisparity=first, numDisparities=count, blockSize=block,
            P1=8 * channels * block**2, P2=32 * channels * block**2, disp12MaxDiff=1, preFilterCap=31,
            uniquenessRatio=5, speckleWindowSize=100, speckleRange=2, mode=mode,
        )  # fmt: skip

        def both(matcher: Any = matcher) -> tuple[Array, Array]:
            rectified = [
                cv2.remap(image, *each, cv2.INTER_LINEAR)
                for image, each in zip((pair.left, pair.right), maps, strict=True)
            ]
            disparity = matcher.compute(*rectified).astype(np.float32) / 16
            return disparity, cv2.reprojectImageTo3D(disparity, q)

        (disparity, _), ms = timed(both, repeats)
        rows.append(
            {
                "name": f"OpenCV {cv2.__version__} StereoSGBM MODE_{name}",
                "called": f"remap + compute + reprojectImageTo3D, {count} disparities, block {block}, colour",
                "key": f"SGBM_{name}",
                "gives": "depth",
                "ms": ms,
                "cloud": on_raw_grid(pair, disparity, first, r1, p1, p2),
            }
        )
    return rows


def disparities(pair: Pair, r1: Array, p1: Array, p2: Array) -> tuple[int, int]:
    """Least disparity of the volume, and how many (a multiple of 16) it spans."""
    rays = corner_rays(pair)
    depth = np.concatenate([(rays * z) @ r1.T for z in (pair.near, pair.far)])[:, 2]
    found = p1[0, 2] - p2[0, 2] - p2[0, 3] / depth
    first = int(np.floor(found.min())) - 1
    return first, int(16 * np.ceil((found.max() + 1 - first) / 16))


def corner_rays(pair: Pair) -> Array:
    """Rays (4, 3) of the left image's corners, z = 1."""
    width, height = pair.size
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)[:, None]
    v = pair.values
    xy = cv2.undistortPoints(corners, v["left_matrix"], v["left_distortion"])[:, 0]
    return np.concatenate([xy, np.ones((4, 1))], axis=1)


def on_raw_grid(pair: Pair, disparity: Array, first: int, r1: Array, p1: Array, p2: Array) -> Array:
    """Points (H, W, 3) float32 in the left camera's frame on its raw pixels, from a rectified disparity map."""
    width, height = pair.size
    v = pair.values
    u, w = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    pixels = np.stack([u, w], axis=-1).reshape(-1, 1, 2)
    place = cv2.undistortPoints(pixels, v["left_matrix"], v["left_distortion"], R=r1, P=p1).reshape(height, width, 2)
    known = np.where(disparity < first, np.nan, disparity).astype(np.float32)
    # An unknown neighbour makes the interpolated value NaN: no point is made up across a border of the known.
    sampled = cv2.remap(known, place.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=np.nan)
    depth = -p2[0, 3] / (sampled - (p1[0, 2] - p2[0, 2]))
    x = (place[..., 0] - p1[0, 2]) / p1[0, 0] * depth
    y = (place[..., 1] - p1[1, 2]) / p1[1, 1] * depth
    return np.asarray(np.stack([x, y, depth], axis=-1) @ r1, dtype=np.float32)


def main() -> None:
    """Run every peer."""
    source, target, repeats, threads = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    quick = "quick" in sys.argv[5:]
    cv2.setNumThreads(threads)
    pair = Pair(source)
    rows: list[dict[str, Any]] = []
    arrays: dict[str, Array] = {}
    for peer in (fringes, opencv_phase, stereo):
        for row in peer(pair, repeats, quick=quick):
            for kind in ("absolute", "cloud"):
                if kind in row:
                    arrays[f"{kind}_{row['key']}"] = row.pop(kind)
            rows.append(row)
            print(f"  {row['name']}: {np.median(row['ms']):.0f} ms", flush=True)
    arrays["rows"] = np.array(json.dumps(rows))
    save: Any = np.savez  # its types take every keyword for an option
    save(target, **arrays)


if __name__ == "__main__":
    main()
