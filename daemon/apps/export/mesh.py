"""Triangles between neighbouring points of an organised cloud, and meshes as GLB files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_STEP = 8.0
"""Longest edge of a triangle, in median distances of neighbours: longer ones join two surfaces."""
_METRE = 0.001


def faces_of(xyz: NDArray[np.float32]) -> NDArray[np.int32]:
    """Triangles of the points of each 2 x 2 pixels, (n, 3) numbers of the valid points; their front is to the camera.

    Four points are divided along the shorter diagonal. Edges longer than LARGEST_STEP are left out.

    Args:
        xyz: (H, W, 3) mm, NaN where invalid.
    """
    valid = np.isfinite(xyz).all(axis=-1)
    across, down = _length(xyz[:, 1:] - xyz[:, :-1]), _length(xyz[1:] - xyz[:-1])
    steps = across[np.isfinite(across)]
    limit = LARGEST_STEP * float(np.median(steps)) if len(steps) else 0.0
    falling, rising = _length(xyz[1:, 1:] - xyz[:-1, :-1]), _length(xyz[1:, :-1] - xyz[:-1, 1:])
    # Comparisons with NaN are false: a triangle has three valid points.
    top, bottom, left, right = across[:-1] <= limit, across[1:] <= limit, down[:, :-1] <= limit, down[:, 1:] <= limit
    by_falling = ~(rising < falling) & (falling <= limit)
    by_rising = ~(falling <= rising) & (rising <= limit)
    number = np.cumsum(valid, dtype=np.int32).reshape(valid.shape) - 1
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    triangles = (
        (by_falling & left & bottom, (a, b, d)),
        (by_falling & top & right, (a, d, c)),
        (by_rising & left & top, (a, b, c)),
        (by_rising & bottom & right, (b, d, c)),
    )
    return np.concatenate([np.stack([corner[kept] for corner in corners], axis=-1) for kept, corners in triangles])


def glb_bytes(
    xyz: NDArray[np.float32],
    *,
    rgb: NDArray[np.uint8] | None = None,
    normals: NDArray[np.float32] | None = None,
    sigma: NDArray[np.float32] | None = None,
    interpolated: NDArray[Any] | None = None,
) -> bytes:
    """Encode the mesh of an organised cloud as a GLB file.

    Its node turns millimetres and the camera's axes into metres and glTF's axes (y up, z towards the viewer); the
    vertices themselves are in the cloud's frame.

    Args:
        xyz: (H, W, 3) mm; rgb: (H, W, 3); normals: (H, W, 3), 0 0 0 where unknown.
        sigma: (H, W) mm, written as the attribute _SIGMA; interpolated: (H, W), as _INTERPOLATED, 0 or 1.
    """
    import trimesh

    valid = np.isfinite(xyz).all(axis=-1)
    given: dict[str, Any] = {}
    if rgb is not None:
        given["vertex_colors"] = rgb[valid]
    if normals is not None:
        given["vertex_normals"] = np.nan_to_num(normals[valid])
    mesh = trimesh.Trimesh(xyz[valid], faces_of(xyz), process=False, validate=False, **given)
    if sigma is not None:
        mesh.vertex_attributes["_SIGMA"] = sigma[valid].astype(np.float32)
    if interpolated is not None:
        mesh.vertex_attributes["_INTERPOLATED"] = interpolated[valid].astype(np.float32)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="cloud", transform=np.diag([_METRE, -_METRE, -_METRE, 1.0]))
    return bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=normals is not None))


def _length(steps: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.sqrt(np.einsum("...k,...k", steps, steps)))
