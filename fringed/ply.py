"""Clouds as PLY files: binary, little-endian, valid points only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def ply_bytes(xyz: NDArray[np.float32], gray: NDArray[np.uint8] | None = None) -> bytes:
    """Encode a cloud as a PLY file; lengths in millimetres.

    Args:
        xyz: (..., 3), mm; points that are not finite are left out.
        gray: (...) texture, written as equal red, green and blue, which viewers support.
    """
    valid = np.isfinite(xyz).all(axis=-1)
    fields: list[tuple[str, str]] = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if gray is not None:
        fields += [("red", "|u1"), ("green", "|u1"), ("blue", "|u1")]
    rows: NDArray[Any] = np.empty(int(valid.sum()), np.dtype(fields))
    for axis, name in enumerate("xyz"):
        rows[name] = xyz[..., axis][valid]
    if gray is not None:
        for name in ("red", "green", "blue"):
            rows[name] = gray[valid]
    kinds = {"<f4": "float", "|u1": "uchar"}
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in fields)
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment unit mm\nelement vertex {len(rows)}\n{properties}end_header\n"
    )
    return head.encode("ascii") + rows.tobytes()
