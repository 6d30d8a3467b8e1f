"""Cloud files: encoding, and reading of the files of a replay."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import InputError
from fringed.pcd import pcd_bytes
from fringed.ply import ply_bytes

KINDS = ("npz", "ply", "pcd")
SUFFIX = ".npz"
"""Of clouds that keep the pixel grid: those of a replay, and snapshots."""

_NUMBER = re.compile(r"_(\d{6,})$")
_WRITTEN = re.compile(rf"cloud_\d{{6,}}\.(?:{'|'.join(KINDS)})")
_MAX_PIXELS = 1 << 28
# Errors of zipfile and numpy for damaged archives; RuntimeError is a flipped "encrypted" flag.
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclass(frozen=True, slots=True, eq=False)
class SavedCloud:
    """The contents of a cloud file.

    Args:
        xyz: (H, W, 3) float32, mm, NaN where invalid; sigma_mm: (H, W) float32; gray: (H, W) uint8.
    """

    xyz: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    gray: NDArray[np.uint8]


def cloud_stem(sequence: int) -> str:
    """The name of a cloud file without suffix, with at least six digits."""
    return f"cloud_{sequence:06d}"


def cloud_name(sequence: int, kind: str) -> str:
    """The name of a cloud file."""
    return f"{cloud_stem(sequence)}.{kind}"


def sequence_of(path: Path) -> int:
    """The number in the name of a cloud or snapshot; -1 without one."""
    match = _NUMBER.search(path.stem)
    return int(match[1]) if match else -1


def written_clouds(directory: Path) -> list[Path]:
    """Files of any kind that bear the name of a replay's cloud."""
    return sorted(path for path in directory.iterdir() if _WRITTEN.fullmatch(path.name))


def cloud_bytes(cloud: SavedCloud, kind: str) -> bytes:
    """Encode a cloud; equal clouds give equal bytes.

    Args:
        kind: ``npz`` (the organised cloud), ``ply`` or ``pcd`` (only the valid points, gray as colour).
    """
    if kind == "ply":
        return ply_bytes(cloud.xyz, cloud.gray)
    if kind == "pcd":
        return pcd_bytes(cloud.xyz, cloud.gray)
    if kind != "npz":
        raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
    buffer = io.BytesIO()
    np.savez(buffer, xyz=cloud.xyz, sigma_mm=cloud.sigma_mm, gray=cloud.gray)
    return buffer.getvalue()


def read_cloud(path: Path) -> SavedCloud:
    """Read a cloud from an npz file.

    Raises:
        DaemonError: the message names the file and its problem.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            xyz = _array(archive, "xyz", np.dtype(np.float32), 3)
            sigma_mm = _array(archive, "sigma_mm", np.dtype(np.float32), 2)
            gray = _array(archive, "gray", np.dtype(np.uint8), 2)
    except _UNREADABLE as error:
        raise InputError(f"{path}: not a cloud of this program: {error}") from error
    if xyz.shape != (*gray.shape, 3) or sigma_mm.shape != gray.shape:
        raise InputError(f"{path}: xyz {xyz.shape}, sigma_mm {sigma_mm.shape} and gray {gray.shape} do not match")
    return SavedCloud(xyz, sigma_mm, gray)


def _array(archive: zipfile.ZipFile, name: str, kind: np.dtype[Any], dimensions: int) -> NDArray[Any]:
    """Read one array; its type and size are checked before the allocation."""
    with archive.open(f"{name}.npy") as file:
        read_header = _HEADERS.get(np.lib.format.read_magic(file))
        if read_header is None:
            raise ValueError(f"{name} has an unknown array format")
        shape, fortran, dtype = read_header(file)
        count = int(np.prod(shape, dtype=np.float64))
        if dtype != kind or fortran or len(shape) != dimensions or not 0 < count <= 3 * _MAX_PIXELS:
            raise ValueError(f"{name} is {dtype} {shape}, expected {kind} in {dimensions} dimensions")
        data = file.read(count * kind.itemsize + 1)
    if len(data) != count * kind.itemsize:
        raise ValueError(f"{name} has {len(data)} bytes, expected {count * kind.itemsize}")
    return np.frombuffer(data, kind).reshape(shape)
