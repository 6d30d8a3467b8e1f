"""All clouds of a recording in one Zarr store, a chunk of each array for a cloud; read by ``fringed.open_clouds``."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daemon.apps.export.cloud_files import SavedCloud
from daemon.common.errors import DaemonError
from fringed.files.cloud_store import ARRAYS, NAME, VERSION

_KINDS: dict[str, tuple[str, float, tuple[int, ...]]] = {
    "xyz": ("float32", float("nan"), (3,)), "sigma_mm": ("float32", float("nan"), ()), "gray": ("uint8", 0, ()),
    "rgb": ("uint8", 0, (3,)), "normals": ("float32", float("nan"), (3,)), "interpolated": ("bool", 0, ()),
}  # fmt: skip
"""Type, value without a result, and channels of each array."""


def prepare_store(folder: Path, sequences: Sequence[int], size: tuple[int, int], parts: Collection[str]) -> None:
    """Make the store of a recording, unless it is there already with the same arrays and rows for the same items.

    Args:
        sequences: numbers of the items, one row each; size: width and height of the left images.
        parts: that are stored besides ARRAYS.
    """
    kinds = {name: kind for name, kind in _KINDS.items() if name in ARRAYS or name in parts}
    try:
        group = _group(folder, "r")
        same = group["sequence"][:].tolist() == list(sequences) and group["gray"].shape[1:] == size[::-1]
        if same and set(group.array_keys()) == {*kinds, "sequence"}:
            return
    except (FileNotFoundError, KeyError):
        pass
    zarr = _zarr()
    group = _group(folder, "w")
    group.attrs.update({"fringed_clouds": VERSION, "unit": "mm"})
    compressor = zarr.codecs.BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")
    for name, (kind, fill, channels) in kinds.items():
        shape = (*size[::-1], *channels)
        group.create_array(
            name, shape=(len(sequences), *shape), chunks=(1, *shape), dtype=kind, fill_value=fill,
            compressors=compressor,
        )  # fmt: skip
    # Last: a store that has it is complete.
    group.create_array("sequence", data=np.array(sequences, dtype=np.int64), chunks=(max(1, len(sequences)),))


def write_row(folder: Path, row: int, cloud: SavedCloud | None) -> None:
    """Write a cloud into its row, or what stands for none: no valid point."""
    group = _group(folder, "r+")
    for name, (_, empty, _) in _KINDS.items():
        if name in group:
            group[name][row] = empty if cloud is None else getattr(cloud, name)


def _group(folder: Path, mode: str) -> Any:
    return _zarr().open_group(str(folder / NAME), mode=mode)


def _zarr() -> Any:
    try:
        import zarr
    except ModuleNotFoundError as error:
        raise DaemonError("--format zarr needs the package zarr: pip install 'fringed[clouds]'") from error
    return zarr
