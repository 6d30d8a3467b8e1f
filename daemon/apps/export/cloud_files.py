"""Cloud files: encoding, and reading of the files of a replay."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.export.mesh import faces_of, glb_bytes
from daemon.common.errors import InputError
from fringed.files.pcd import pcd_bytes
from fringed.files.ply import ply_bytes
from fringed.parts import PARTS

if TYPE_CHECKING:
    from pipeline.reconstruct.cloud import Cloud

KINDS = ("npz", "ply", "pcd", "mesh.ply", "glb")
DEFAULT_PARTS = ("xyz", "gray")
"""Of files that are no npz, unless others are named."""
SUFFIX = ".npz"
"""Of clouds that keep the pixel grid: those of a replay, and snapshots."""

_NUMBER = re.compile(r"_(\d{6,})$")
_WRITTEN = re.compile(rf"cloud_\d{{6,}}\.(?:{'|'.join(map(re.escape, KINDS))})")
_KEYS = {"sigma": "sigma_mm"}
_EXTRA: dict[str, tuple[np.dtype[Any], int]] = {
    "rgb": (np.dtype(np.uint8), 3),
    "normals": (np.dtype(np.float32), 3),
    "interpolated": (np.dtype(np.bool_), 2),
}
_MAX_PIXELS = 1 << 28
# Errors of zipfile and numpy for damaged archives; RuntimeError is a flipped "encrypted" flag.
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


@dataclass(frozen=True, slots=True, eq=False)
class SavedCloud:
    """The contents of a cloud file.

    Args:
        xyz: (H, W, 3) float32, mm, NaN where invalid; sigma_mm: (H, W) float32; gray: (H, W) uint8.
        rgb: (H, W, 3) uint8; normals: (H, W, 3) float32, NaN where unknown; interpolated: (H, W) bool; None where the
            file has none.
    """

    xyz: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    gray: NDArray[np.uint8]
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    interpolated: NDArray[np.bool_] | None = None

    @staticmethod
    def of(cloud: Cloud) -> SavedCloud:
        """What files keep of a cloud."""
        filled = None if cloud.interpolated is None else cloud.interpolated.view(np.bool_)
        return SavedCloud(cloud.xyz, cloud.sigma_mm, cloud.gray, cloud.rgb, cloud.normals, filled)

    def part(self, name: str) -> Any:
        """A part by its name, None without it."""
        return getattr(self, _KEYS.get(name, name))

    def completed(self, parts: Collection[str], where: object) -> SavedCloud:
        """The cloud with these parts: normals are computed, and without a mark no point was filled in.

        Raises:
            InputError: ``where``, the source, has no colour.
        """
        if "rgb" in parts and self.rgb is None:
            raise InputError(
                f"{where} has no rgb, which only raw images give; name their take, or have rgb in outputs.parts"
            )
        added: dict[str, Any] = {}
        if "normals" in parts and self.normals is None:
            from pipeline.attributes.normals import normals_of

            added["normals"] = normals_of(self.xyz, self.sigma_mm)
        if "interpolated" in parts and self.interpolated is None:
            added["interpolated"] = np.zeros(self.gray.shape, np.bool_)
        return replace(self, **added) if added else self


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


def cloud_bytes(cloud: SavedCloud, kind: str, parts: Collection[str] | None = None) -> bytes:
    """Encode a cloud; equal clouds give equal bytes.

    Args:
        kind: ``npz`` (the organised cloud), ``ply`` or ``pcd`` (only the valid points), ``mesh.ply`` or ``glb`` (with
            triangles between neighbours).
        parts: to write, which the cloud must have; None = DEFAULT_PARTS. The texture is the colour of files without
            ``rgb``. An npz has xyz, sigma_mm and gray in any case, and without ``parts`` all that the cloud has.
    """
    if kind not in KINDS:
        raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
    if kind == "npz":
        buffer = io.BytesIO()
        extra = {name: cloud.part(name) for name in _EXTRA if parts is None or name in parts}
        given = {name: array for name, array in extra.items() if array is not None}
        np.savez(buffer, xyz=cloud.xyz, sigma_mm=cloud.sigma_mm, gray=cloud.gray, **given)
        return buffer.getvalue()
    chosen = DEFAULT_PARTS if parts is None else parts
    given = {name: cloud.part(name) for name in chosen if name != "xyz"}
    if kind == "glb":
        gray = given.pop("gray", None)
        if gray is not None and given.get("rgb") is None:
            given["rgb"] = np.repeat(gray[..., None], 3, axis=2)
        return glb_bytes(cloud.xyz, **given)
    if kind == "pcd":
        return pcd_bytes(cloud.xyz, **given)
    return ply_bytes(cloud.xyz, **given, faces=faces_of(cloud.xyz) if kind == "mesh.ply" else None)


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
            names = set(archive.namelist())
            extra = {name: _array(archive, name, *kind) for name, kind in _EXTRA.items() if f"{name}.npy" in names}
    except _UNREADABLE as error:
        raise InputError(f"{path}: not a cloud of this program: {error}") from error
    if xyz.shape != (*gray.shape, 3) or sigma_mm.shape != gray.shape:
        raise InputError(f"{path}: xyz {xyz.shape}, sigma_mm {sigma_mm.shape} and gray {gray.shape} do not match")
    for name, array in extra.items():
        if array.shape != (*gray.shape, *PARTS[name][1]):
            raise InputError(f"{path}: {name} {array.shape} does not match gray {gray.shape}")
    return SavedCloud(xyz, sigma_mm, gray, **extra)


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
