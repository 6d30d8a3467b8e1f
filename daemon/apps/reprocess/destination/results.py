"""The files of a run: clouds of each recording, manifests of its finished chunks, markers of failed ones.

    DEST/reprocess.json            the job, written first
    DEST/report.json, report.html
    DEST/NAME/summary.json         as of a replay, when every chunk of the recording is done
    DEST/NAME/cloud_000042.npz
    DEST/NAME/chunks/chunk_000000032.json, or chunk_000000032.failed.json

A chunk is done when its manifest is there: it is written after all clouds of the chunk.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from daemon.apps.reprocess.carried_state import CarriedState
from daemon.apps.reprocess.locations import is_local, read_if_there, write_whole

VERSION = 1


@dataclass(slots=True)
class ChunkManifest:
    """The results of a chunk besides its clouds.

    Args:
        key: see ``Job.key``; source: hash of the chunk's frames, by their heads.
        before, after: the state carried into and out of the chunk.
        rows: one mapping for each cloud: fields of a replay's run, ``coverage`` and ``rejected``.
        failed: pairs that the pipeline rejected; files: names of the clouds.
        seconds: time of the task; cpu_seconds: processor time of its process meanwhile; worker: that process.
    """

    key: str
    source: str
    calibration: str
    before: CarriedState
    after: CarriedState
    release: dict[str, str] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    failed: list[dict[str, Any]] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    worker: str = ""

    def as_json(self) -> bytes:
        """The bytes of the manifest's file."""
        values = asdict(self) | {"version": VERSION, "before": self.before.as_json(), "after": self.after.as_json()}
        return (json.dumps(values, indent=1) + "\n").encode()

    @classmethod
    def parse(cls, data: bytes) -> ChunkManifest | None:
        """The manifest in the bytes of a file; None for anything else, which is then done again."""
        try:
            values = json.loads(data)
            if values.pop("version") != VERSION:
                return None
            states = {name: CarriedState.from_json(values[name]) for name in ("before", "after")}
            return cls(**(values | states))
        except (ValueError, KeyError, TypeError, AttributeError):
            return None


class TakeResults:
    """The folder of one recording in the destination."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def manifest(self, chunk: str) -> ChunkManifest | None:
        """The manifest of a finished chunk; None if it is not finished."""
        data = read_if_there(self.folder / "chunks" / f"{chunk}.json")
        return None if data is None else ChunkManifest.parse(data)

    def finish(self, chunk: str, manifest: ChunkManifest) -> None:
        """Mark a chunk whose clouds are all written as done."""
        write_whole(self.folder / "chunks" / f"{chunk}.json", manifest.as_json())
        self.clear_failure(chunk)

    def begin(self, chunk: str) -> None:
        """Mark a chunk as not done."""
        with suppress(FileNotFoundError):
            (self.folder / "chunks" / f"{chunk}.json").unlink()

    def keep_only(self, keys: Mapping[str, str]) -> None:
        """Remove the manifests of all chunks but these with these keys, then the clouds that only those list."""
        for path in self._manifests():
            chunk = path.name.removesuffix(".json")
            manifest = self.manifest(chunk)
            if manifest is not None and manifest.key == keys.get(chunk):
                continue
            self.begin(chunk)
            for name in () if manifest is None else manifest.files:
                with suppress(FileNotFoundError):
                    (self.folder / name).unlink()

    def _manifests(self) -> list[Path]:
        try:
            files = list((self.folder / "chunks").iterdir())
        except (FileNotFoundError, NotADirectoryError):
            return []
        return [file for file in files if file.name.endswith(".json") and not file.name.endswith(".failed.json")]

    def failure(self, chunk: str, key: str) -> str:
        """Reason why this chunk failed in an earlier run; empty if it did not, or would be another chunk today."""
        data = read_if_there(self.folder / "chunks" / f"{chunk}.failed.json")
        try:
            values = {} if data is None else json.loads(data)
            return str(values["reason"]) if values.get("key") == key else ""
        except (ValueError, AttributeError, KeyError):
            return ""

    def fail(self, chunk: str, key: str, reason: str) -> None:
        """Note the reason of a failure."""
        text = json.dumps({"key": key, "reason": reason}, indent=1) + "\n"
        write_whole(self.folder / "chunks" / f"{chunk}.failed.json", text.encode())

    def clear_failure(self, chunk: str) -> None:
        """Forget an earlier failure."""
        with suppress(FileNotFoundError):
            (self.folder / "chunks" / f"{chunk}.failed.json").unlink()

    def remove_unfinished_files(self) -> None:
        """Remove what killed processes left: temporary files."""
        if not is_local(self.folder):
            return
        for folder in (self.folder, self.folder / "chunks"):
            for file in folder.glob(".*.tmp"):
                with suppress(OSError):
                    file.unlink()
