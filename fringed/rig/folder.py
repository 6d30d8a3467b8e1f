"""Clouds in files: the folder of a replay, a single snapshot, and the Zarr store of a reprocessing."""

from __future__ import annotations

import json
import re
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fringed.errors import NotLiveError, RecordingError
from fringed.files.cloud_store import ARRAYS, OPTIONAL, StoredClouds, open_clouds
from fringed.parts import PARTS
from fringed.rig.preview import Preview
from fringed.rig.recorded import FILE_NAMES
from fringed.stream.received_cloud import ReceivedCloud
from fringed.wire import CloudHeader

SUFFIX = ".npz"
_NUMBER = re.compile(r"_(\d{6,})$")
_NAMES = {FILE_NAMES.get(name, name) for name in PARTS}
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile)


class CloudFiles(ABC):
    """Clouds that were reconstructed earlier: no images, and no settings that could change them.

    Args:
        place: shown in messages; summary: of the replay, with session, device and calibration, if there is one.
    """

    def __init__(self, place: str, summary: dict[str, Any]) -> None:
        self.place = place
        self.device, self.session, self.calibration = (
            str(summary.get(key) or "") for key in ("device", "session", "calibration")
        )
        self.mode = str(summary.get("mode", "single"))

    def clouds(self, parts: tuple[str, ...] | None) -> Iterator[ReceivedCloud]:
        """Yield the clouds in their order, with these parts, or with points only.

        Raises:
            RecordingError: a file that cannot be read, or that has none of a part that is named.
        """
        for seq, where, arrays in self._stored():
            yield self._cloud(seq, where, arrays, parts)

    @abstractmethod
    def _stored(self) -> Iterator[tuple[int, str, dict[str, Any]]]:
        """Yield number, place and arrays of each cloud."""

    def previews(self) -> Iterator[Preview]:
        """Refuse: there are no images."""
        raise NotLiveError(f"{self.place} holds clouds without camera images; open the take for previews")

    def settings(self) -> list[dict[str, Any]]:
        """Return no setting: the clouds are reconstructed already."""
        return []

    def set(self, path: str, value: Any) -> Any:
        """Refuse: the clouds are reconstructed already."""
        raise NotLiveError(f"{self.place} holds finished clouds: {path} cannot become {value!r:.40}; open the take")

    def close(self) -> None:  # noqa: B027 - no file is open between clouds
        """Close nothing: each file is closed after its cloud is read."""

    def _cloud(self, seq: int, where: str, arrays: dict[str, Any], parts: tuple[str, ...] | None) -> ReceivedCloud:
        xyz = arrays.get("xyz")
        if xyz is None or xyz.ndim != 3 or xyz.shape[2] != 3:
            raise RecordingError(f"{where}: there is no array xyz of shape (H, W, 3)")
        height, width = xyz.shape[:2]
        valid = float(np.isfinite(xyz[..., 2]).mean())
        header = CloudHeader(
            kind="cloud", seq=max(seq, 0), session=self.session, device=self.device, calibration=self.calibration,
            width=width, height=height, stats={"valid": round(valid, 4)},
        )  # fmt: skip
        found = {name: arrays.get(FILE_NAMES.get(name, name)) for name in parts or ("xyz",)}
        if "interpolated" in found and found["interpolated"] is None:
            found["interpolated"] = np.zeros((height, width), np.bool_)
        missing = [name for name in found if found[name] is None]
        if missing:
            raise RecordingError(f"{where} has no {missing[0]}; name parts that it has, or open the take")
        values: dict[str, Any] = dict.fromkeys(PARTS) | found
        return ReceivedCloud(header, **values)


class NpzClouds(CloudFiles):
    """Clouds as .npz files.

    Args:
        path: a folder of ``fringed replay --out``, or one file.
    """

    def __init__(self, path: Path) -> None:
        folder = path if path.is_dir() else path.parent
        super().__init__(str(path), _summary(folder))
        files = path.glob(f"*{SUFFIX}") if path.is_dir() else [path]
        self._files = sorted((_number(file), file) for file in files if not file.name.startswith("."))

    def _stored(self) -> Iterator[tuple[int, str, dict[str, Any]]]:
        for seq, file in self._files:
            try:
                with np.load(file, allow_pickle=False) as archive:
                    arrays = {name: archive[name] for name in archive.files if name in _NAMES}
            except _UNREADABLE as error:
                raise RecordingError(f"{file}: not a cloud of this program: {error}") from error
            yield seq, str(file), arrays


class ZarrClouds(CloudFiles):
    """Clouds of a Zarr store; needs the package zarr."""

    def __init__(self, place: str) -> None:
        super().__init__(place, {})
        self._store: StoredClouds = open_clouds(place)

    def _stored(self) -> Iterator[tuple[int, str, dict[str, Any]]]:
        for cloud in self._store:
            arrays = {name: getattr(cloud, name) for name in (*ARRAYS, *OPTIONAL)}
            yield cloud.sequence, f"{self.place}, pair {cloud.sequence}", arrays


def _number(file: Path) -> int:
    match = _NUMBER.search(file.stem)
    return int(match[1]) if match else -1


def _summary(folder: Path) -> dict[str, Any]:
    with suppress(OSError, ValueError):
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        if isinstance(summary, dict):
            return summary
    return {}
