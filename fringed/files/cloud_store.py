"""Read the clouds of a Zarr store, as ``fringed reprocess --format zarr`` writes it.

from fringed import open_clouds

for cloud in open_clouds("results/part7"):
print(cloud.sequence, cloud.xyz.shape)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from fringed.errors import FringedError

NAME = "clouds.zarr"
VERSION = 1
ARRAYS = ("xyz", "sigma_mm", "gray")
"""Of every store."""
OPTIONAL = ("rgb", "normals", "interpolated")
"""Of a store for which they were asked."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredCloud:
    """A cloud of a store.

    Args:
        sequence: number of its pair.
        xyz: (H, W, 3) float32, mm, NaN where invalid; sigma_mm: (H, W) float32, mm; gray: (H, W) uint8.
        rgb: (H, W, 3) uint8; normals: (H, W, 3) float32, NaN where unknown; interpolated: (H, W) bool; None in a store
            without them.
    """

    sequence: int
    xyz: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    gray: NDArray[np.uint8]
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    interpolated: NDArray[np.bool_] | None = None


class StoredClouds(Sequence[StoredCloud]):
    """The clouds of one recording, each read when it is asked for; one without a result has no valid point."""

    def __init__(self, group: Any) -> None:
        self._arrays = {name: group[name] for name in (*ARRAYS, *(name for name in OPTIONAL if name in group))}
        self.sequences: NDArray[np.int64] = np.asarray(group["sequence"][:])

    def __len__(self) -> int:
        return len(self.sequences)

    def __iter__(self) -> Iterator[StoredCloud]:
        return (self[row] for row in range(len(self)))

    @overload
    def __getitem__(self, row: int) -> StoredCloud: ...

    @overload
    def __getitem__(self, row: slice) -> list[StoredCloud]: ...

    def __getitem__(self, row: int | slice) -> StoredCloud | list[StoredCloud]:
        """The cloud of a row, or of several."""
        if isinstance(row, slice):
            return [self[number] for number in range(*row.indices(len(self)))]
        number = int(self.sequences[row])
        return StoredCloud(number, **{name: np.asarray(array[row]) for name, array in self._arrays.items()})

    def of(self, sequence: int) -> StoredCloud:
        """The cloud of a pair by its number, the last one of that number.

        Raises:
            KeyError: the recording has no such pair.
        """
        rows = np.flatnonzero(self.sequences == sequence)
        if not len(rows):
            raise KeyError(f"no pair has the number {sequence}")
        return self[int(rows[-1])]


def open_clouds(place: str | PathLike[str]) -> StoredClouds:
    """Open the clouds of a recording.

    Args:
        place: path or URL of the recording's folder in the destination, or of its ``clouds.zarr``.

    Raises:
        FringedError: no store there, one of another version, or the package zarr is missing.
    """
    try:
        import zarr
    except ModuleNotFoundError as error:
        raise FringedError("clouds in a Zarr store need the package zarr: pip install 'fringed[clouds]'") from error
    text = fspath(place).rstrip("/")
    store = text if text.endswith(".zarr") else f"{text}/{NAME}"
    try:
        group = zarr.open_group(store, mode="r")
        version = group.attrs.get("fringed_clouds")
    except (OSError, ValueError, KeyError) as error:
        raise FringedError(f"{store}: no store of clouds can be read there: {error}") from error
    if version != VERSION:
        raise FringedError(f"{store}: version {version} of the store, this program reads version {VERSION}")
    return StoredClouds(group)
