"""The directory of a replay: its clouds and summary.json, never beside the clouds of another one."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name, written_clouds
from daemon.apps.replay.runner import Result
from daemon.apps.replay.summary import NAME
from daemon.common.errors import InputError
from daemon.common.files import write_atomically


class ReplayDirectory:
    """Writes the clouds of one replay; those of an earlier one are removed before the first.

    Args:
        path: made when it is missing; take: named in summary.json from the first cloud on.

    Raises:
        InputError: it contains clouds that no replay wrote, or is a file.
    """

    def __init__(self, path: Path, take: Path) -> None:
        if path.exists() and not path.is_dir():
            raise InputError(f"--out {path} is a file; name a directory")
        self._path, self._take = path, take
        self._begun = False
        #: Clouds of an earlier replay that were removed.
        self.removed = 0
        earlier = written_clouds(path) if path.is_dir() else []
        if earlier and not (path / NAME).exists():
            raise InputError(
                f"{path} contains {len(earlier)} clouds that no replay wrote ({earlier[0].name}, but no {NAME}); "
                "choose another directory, or remove them"
            )

    def begin(self) -> None:
        """Remove the clouds of an earlier replay, once; summary.json has ``complete: false`` from then on."""
        if self._begun:
            return
        self._begun = True
        self._path.mkdir(parents=True, exist_ok=True)
        summary = {"take": str(self._take), "complete": False}
        write_atomically(self._path / NAME, (json.dumps(summary, indent=1) + "\n").encode())
        for cloud in written_clouds(self._path):
            cloud.unlink()
            self.removed += 1

    def write(self, kind: str, result: Result, parts: Collection[str] | None = None) -> None:
        """Write one cloud, with these parts."""
        self.begin()
        cloud = SavedCloud.of(result.cloud).completed(parts or (), self._take)
        write_atomically(self._path / cloud_name(result.pair.sequence, kind), cloud_bytes(cloud, kind, parts))
