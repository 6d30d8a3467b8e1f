"""Points, colour and normals on real images: ``python -m benchmarks.real_images DIR``, of a data set with a reference.

DIR has a take, ``reference.npz`` (points from a sequence of patterns, ``xyz``) and ``multiframe/left_step0..3.png``:
four real images of one grey scene whose mean is the texture without fringes. The normals of the reference are planes
fitted to 9 x 9 of its points. A flat part is the middle of 61 x 61 reference points with a deviation from their plane
below 0.6 mm. ``--images DIR`` writes colour, normals and mesh.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.apps.export.mesh import faces_of
from daemon.apps.replay.runner import Replay
from daemon.recording.read.take_reader import TakeReader
from pipeline.attributes.normals import normals_of
from pipeline.common.settings import Settings
from pipeline.reconstruct.cloud import Cloud

Array = NDArray[Any]
WINDOW, FLAT_WINDOW, FLAT_MM = 9, 61, 0.6
NEAR_MM, WRONG_MM = 3.0, 20.0
SMOOTHING_PX = 2.0


def main() -> None:
    """Print a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--images", type=Path, help="directory for color.png, normals.png and mesh.png")
    options = parser.parse_args()
    cloud, smooth = (
        _cloud(options.data / "take.mcap", Settings(smoothing_sigma_px=value)) for value in (0.0, SMOOTHING_PX)
    )
    reference = np.load(options.data / "reference.npz")["xyz"]
    error = np.linalg.norm(cloud.xyz - reference, axis=-1)
    known, found = np.isfinite(reference[..., 2]).sum(), np.isfinite(error).sum()
    print(f"points within {NEAR_MM:g} mm of the reference: {(error < NEAR_MM).sum() / known:.1%} of {known}")
    print(f"points farther than {WRONG_MM:g} mm: {(error > WRONG_MM).sum() / found:.3%}")
    _color(cloud, [options.data / "multiframe" / f"left_step{k}.png" for k in range(4)])
    truth, _ = planes(reference, WINDOW)
    flat, deviation = planes(reference, FLAT_WINDOW)
    flat[~(deviation < FLAT_MM)] = np.nan
    of_reference = normals_of(reference, np.where(np.isfinite(reference[..., 2]), 1, np.nan).astype(np.float32))
    for name, normals in (
        ("default settings", cloud.normals), (f"smoothing {SMOOTHING_PX:g} px", smooth.normals),
        ("reference, same fit", of_reference),
    ):  # fmt: skip
        _angles(f"normals, {name}, to the reference's planes", normals, truth)
        _angles(f"normals, {name}, to flat parts", normals, flat)
    if options.images is not None:
        _write_images(options.images, cloud)


def _cloud(take: Path, settings: Settings) -> Cloud:
    with TakeReader(take) as reader:
        return next(Replay(reader, settings, parts=("rgb", "normals")).results()).cloud


def _gray(path: Path) -> Array:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{path}: not an image")
    return image


def _color(cloud: Cloud, images: list[Path]) -> None:
    """Error of the colour of points against the mean of the images, after one common factor."""
    assert cloud.rgb is not None
    steps = np.stack([_gray(path) for path in images])
    where = np.isfinite(cloud.xyz[..., 2]) & (steps.max(axis=0) < 255)
    texture, color = steps[:, where].mean(axis=0), cloud.rgb[where].astype(np.float64)
    mean = color.mean(axis=1)
    error = np.abs(color - (np.median(mean / texture) * texture)[:, None]).mean() / 255
    tint = np.abs(color / mean[:, None] - 1).mean()
    print(f"colour: mean error {error:.2%} of full scale; a channel differs from the mean of the three by {tint:.1%}")


def planes(xyz: Array, window: int) -> tuple[Array, Array]:
    """Normals towards the camera (H, W, 3) of planes fitted to whole windows, and the points' rms distance (H, W), mm.

    Total least squares; NaN where a point of the window is unknown.
    """
    known = np.isfinite(xyz[..., 2])
    points = np.where(known[..., None], xyz - xyz[known].mean(axis=0, dtype=np.float64), 0)
    products = np.einsum("...i,...j->...ij", points, points).reshape(*known.shape, 9)

    def mean(values: Array) -> Array:
        layers = [cv2.blur(layer, (window, window)) for layer in np.moveaxis(values, -1, 0)]
        return np.stack(layers, axis=-1)

    whole = mean(known[..., None].astype(np.float64))[..., 0] > 1 - 0.5 / window**2
    centre, second = mean(points)[whole], mean(products)[whole].reshape(-1, 3, 3)
    squares, axes = np.linalg.eigh(second - centre[:, :, None] * centre[:, None, :])
    normals, rms = np.full(xyz.shape, np.nan), np.full(known.shape, np.nan)
    away = np.sum(axes[..., 0] * xyz[whole], axis=-1, keepdims=True) > 0
    normals[whole], rms[whole] = np.where(away, -axes[..., 0], axes[..., 0]), np.sqrt(np.maximum(squares[:, 0], 0))
    return normals, rms


def _angles(name: str, normals: Array | None, truth: Array) -> None:
    cosine = np.sum(normals * truth, axis=-1)
    degrees = np.degrees(np.arccos(np.clip(cosine[np.isfinite(cosine)], -1, 1)))
    print(f"{name}: mean {degrees.mean():.1f}°, median {np.median(degrees):.1f}°, {len(degrees)} points")


def _write_images(folder: Path, cloud: Cloud) -> None:
    """Colour, normals as (1 + n) / 2 with y up, and triangles shaded by their angle to the view."""
    assert cloud.rgb is not None and cloud.normals is not None
    folder.mkdir(parents=True, exist_ok=True)
    normals = (np.nan_to_num((1 + cloud.normals * [1, -1, -1]) / 2) * 255).astype(np.uint8)
    points = cloud.xyz[np.isfinite(cloud.xyz).all(axis=-1)]
    pixels = np.argwhere(np.isfinite(cloud.xyz).all(axis=-1))
    faces = faces_of(cloud.xyz)
    a, b, c = (points[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    mesh = np.zeros(cloud.gray.shape, np.uint8)
    mesh[tuple(pixels[faces[:, 0]].T)] = 255 * np.abs(across[:, 2]) / np.linalg.norm(across, axis=1)
    for name, image in (("color", cloud.rgb[..., ::-1]), ("normals", normals[..., ::-1]), ("mesh", mesh)):
        cv2.imwrite(str(folder / f"{name}.png"), image)


if __name__ == "__main__":
    main()
