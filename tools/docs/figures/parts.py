"""Figure of a cloud's optional parts: colour, normals, mesh, and the error of one cloud and of eight fused ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from daemon.apps.export.mesh import faces_of
from pipeline.attributes.normals import normals_of
from pipeline.common.settings import Settings
from pipeline.reconstruct.cloud_filters import cloud_filters
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.render.render_pair import render_pair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.scene import Scene

CLOUDS = 8
_EVERY = 16
"""Pixels between the vertices of the drawn mesh."""
_DPI, _LARGEST_UM = 120, 100.0


def draw(scene: Scene, folder: Path, *, scale: float = 1.0) -> list[Path]:
    """Measure a scene at rest eight times and draw the figure.

    Args:
        scene: on the stage; scale: of the images' size.
    """
    layout, optics = RigLayout().scaled(scale), Optics()
    pattern, calibration = layout.pattern(), layout.calibration_for(optics)
    reconstructor = Reconstructor(calibration, pattern, layout.volume())
    fusion = cloud_filters(calibration, Settings(fusion_clouds=CLOUDS), mosaic=False, fuse=True)
    if fusion is None:
        raise ValueError("temporal fusion is off")
    for seed in range(CLOUDS):
        pair = render_pair(layout, scene, pattern, optics, seed=seed)
        cloud = reconstructor.reconstruct(pair.left, pair.right)
        fused = fusion.apply(cloud)
    errors = [1e3 * np.linalg.norm(one.xyz - pair.truth_left.xyz, axis=-1) for one in (cloud, fused)]
    figure, axes = plt.subplots(2, 3, figsize=(10.2, 6.8), layout="constrained")
    color = reconstructor.color(pair.left)
    _image(axes[0, 0], color / np.percentile(color, 99.5), "rgb")
    normals = normals_of(cloud.xyz, cloud.sigma_mm)
    _image(axes[0, 1], (1 - normals) / 2, "normals, red x, green y, blue z")
    _mesh(axes[0, 2], cloud.xyz[::_EVERY, ::_EVERY], color[::_EVERY, ::_EVERY])
    for panel, error, name in zip(axes[1], errors, ("one cloud", f"{CLOUDS} clouds fused"), strict=False):
        title = f"error, {name}: median {np.nanmedian(error):.0f} um"
        shown = _image(panel, error, title, cmap="magma_r", vmin=0, vmax=_LARGEST_UM)
    figure.colorbar(shown, ax=axes[1, :2], label="um", location="bottom", shrink=0.5)
    ratio = fused.sigma_mm / cloud.sigma_mm
    shown = _image(axes[1, 2], ratio, "sigma, fused / one cloud", cmap="viridis", vmin=0, vmax=1)
    figure.colorbar(shown, ax=axes[1, 2], location="bottom", label="ratio")
    path = folder / "parts.png"
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})
    plt.close(figure)
    return [path]


def _image(axes: Any, values: NDArray[Any], title: str, **options: Any) -> Any:
    axes.set_facecolor("#e9ecef")
    axes.set(xticks=[], yticks=[], title=title)
    if values.ndim == 3:
        known = np.isfinite(values).all(axis=-1)
        values = np.concatenate([np.nan_to_num(values), known[..., None]], axis=-1).clip(0, 1)
    return axes.imshow(values, interpolation="nearest", **options)


def _mesh(axes: Any, xyz: NDArray[np.float32], color: NDArray[np.uint8]) -> None:
    """The exported triangles of a coarse cloud, seen along the optical axis, with the colour of a corner."""
    known = np.isfinite(xyz).all(axis=-1)
    points, faces = xyz[known], faces_of(xyz)
    faces = faces[np.argsort(-points[faces][..., 2].mean(axis=1))]
    fill = np.clip(color[known][faces[:, 0]] / np.percentile(color, 99.5), 0, 1)
    corners = list(points[faces][..., :2])
    axes.add_collection(PolyCollection(corners, facecolors=fill, edgecolors="#1d2733", linewidths=0.2))
    axes.autoscale_view()
    axes.invert_yaxis()
    axes.set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title=f"mesh, of every {_EVERY}th pixel")
