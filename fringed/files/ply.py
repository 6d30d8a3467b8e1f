"""Clouds as PLY files: binary, little-endian, valid points only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringed.files.point_rows import directions, point_rows, positions, quality

_KINDS = {"<f4": "float", "|u1": "uchar"}


def ply_bytes(
    xyz: NDArray[np.float32],
    gray: NDArray[np.uint8] | None = None,
    *,
    rgb: NDArray[np.uint8] | None = None,
    normals: NDArray[np.float32] | None = None,
    sigma: NDArray[np.float32] | None = None,
    interpolated: NDArray[Any] | None = None,
    faces: NDArray[np.int32] | None = None,
) -> bytes:
    """Encode a cloud as a PLY file; lengths in millimetres.

    Args:
        xyz: (..., 3), mm; points that are not finite are left out.
        gray: (...) texture, written as equal red, green and blue, which viewers support; rgb: (..., 3) instead of it.
        normals: (..., 3), written as nx, ny, nz; 0 0 0 where unknown.
        sigma: (...), mm; interpolated: (...), written as 0 or 1.
        faces: (n, 3) triangles, numbers of the valid points.
    """
    columns = positions(xyz) + directions("n{}", normals)
    colors = ("red", "green", "blue")
    if rgb is not None:
        columns += [(name, "|u1", rgb[..., channel]) for channel, name in enumerate(colors)]
    elif gray is not None:
        columns += [(name, "|u1", gray) for name in colors]
    columns += quality(sigma, interpolated)
    rows = point_rows(xyz, columns)
    properties = "".join(f"property {_KINDS[kind]} {name}\n" for name, kind, _ in columns)
    head = f"ply\nformat binary_little_endian 1.0\ncomment unit mm\nelement vertex {len(rows)}\n{properties}"
    if faces is None:
        return f"{head}end_header\n".encode("ascii") + rows.tobytes()
    triangles: NDArray[Any] = np.empty(len(faces), np.dtype([("count", "|u1"), ("points", "<i4", (3,))]))
    triangles["count"], triangles["points"] = 3, faces
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    return head.encode("ascii") + rows.tobytes() + triangles.tobytes()
