"""Clouds as PCD 0.7 files: binary, valid points only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringed.files.point_rows import directions, point_rows, positions, quality


def pcd_bytes(
    xyz: NDArray[np.float32],
    gray: NDArray[np.uint8] | None = None,
    *,
    rgb: NDArray[np.uint8] | None = None,
    normals: NDArray[np.float32] | None = None,
    sigma: NDArray[np.float32] | None = None,
    interpolated: NDArray[Any] | None = None,
) -> bytes:
    """Encode a cloud as a PCD file; lengths in millimetres.

    Args:
        xyz: (..., 3), mm; points that are not finite are left out.
        gray: (...) texture, written as ``rgb`` in PCL's packing: 0xRRGGBB in the four bytes of a float; rgb: (..., 3)
            instead of it.
        normals: (..., 3), written as normal_x, normal_y, normal_z; 0 0 0 where unknown.
        sigma: (...), mm; interpolated: (...), written as 0 or 1.
    """
    columns = positions(xyz)
    if rgb is not None:
        columns.append(("rgb", "<u4", rgb.astype(np.uint32) @ np.array([0x10000, 0x100, 1], np.uint32)))
    elif gray is not None:
        columns.append(("rgb", "<u4", gray.astype(np.uint32) * 0x010101))
    columns += directions("normal_{}", normals) + quality(sigma, interpolated)
    rows = point_rows(xyz, columns)

    def line(key: str, *values: Any) -> str:
        return " ".join([key, *map(str, values)]) + "\n"

    head = (
        "# .PCD v0.7 - Point Cloud Data file format\n# unit mm\nVERSION 0.7\n"
        + line("FIELDS", *(name for name, _, _ in columns))
        + line("SIZE", *(kind[-1] for _, kind, _ in columns))
        + line("TYPE", *("U" if kind == "|u1" else "F" for _, kind, _ in columns))
        + line("COUNT", *[1] * len(columns))
        + f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
    )
    return head.encode("ascii") + rows.tobytes()
