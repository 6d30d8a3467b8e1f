"""Clouds as PCD 0.7 files: binary, valid points only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_ROW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])


def pcd_bytes(xyz: NDArray[np.float32], gray: NDArray[np.uint8]) -> bytes:
    """Encode a cloud as a PCD file; lengths in millimetres.

    Args:
        xyz: (..., 3), mm; points that are not finite are left out.
        gray: (...) texture, written as ``rgb`` in PCL's packing: 0xRRGGBB in the four bytes of a float.
    """
    valid = np.isfinite(xyz).all(axis=-1)
    rows: NDArray[Any] = np.empty(int(valid.sum()), _ROW)
    for axis, name in enumerate("xyz"):
        rows[name] = xyz[..., axis][valid]
    rows["rgb"] = gray[valid].astype(np.uint32) * 0x010101
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\n# unit mm\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\n"
        f"TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(rows)}\nDATA binary\n"
    )
    return head.encode("ascii") + rows.tobytes()
