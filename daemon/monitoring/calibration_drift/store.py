"""The drift monitor's files: references by calibration, and a history of bounded size.

``references.json`` holds the observables of each calibration when it was new, so that a disturbance while the daemon
was off is reported at the next start; without the file (or a calibration's entry) the daemon learns them again.
``history.jsonl`` has one JSON object a line: the observables once a minute, and every event; at 1 MB it becomes
``history.1.jsonl``.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from daemon.common.errors import DaemonError
from daemon.common.files import read_at_most, write_atomically
from daemon.monitoring.calibration_drift.verdicts import Reference

log = logging.getLogger("fringed.selfcheck")

MAX_HISTORY_BYTES = 1_000_000
_MAX_REFERENCES_BYTES = 1_000_000
_MAX_CALIBRATIONS = 64


class Store:
    """Files in a directory, which is created at the first write. A disk error is logged once.

    Args:
        directory: of the files; key: of the references (calibration, pattern, encoding).
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory, self._key = directory, key
        self._refused = False

    @property
    def references_file(self) -> Path:
        """File of the references."""
        return self.directory / "references.json"

    @property
    def history_file(self) -> Path:
        """File that the history is appended to."""
        return self.directory / "history.jsonl"

    def references(self) -> dict[str, Reference]:
        """Return the references of this calibration; empty when there are none, or none that can be read."""
        entry = self._all().get(self._key)
        values = entry.get("observables") if isinstance(entry, dict) else None
        out = {}
        for name, pair in (values if isinstance(values, dict) else {}).items():
            try:
                value, scatter = float(pair["value"]), float(pair["scatter"])
            except (KeyError, TypeError, ValueError):
                continue
            if math.isfinite(value) and 0 <= scatter < math.inf:
                out[str(name)] = Reference(value, scatter)
        return out

    def save(self, references: Mapping[str, Reference], t_ns: int) -> None:
        """Write the references; beyond the limit, those of the calibrations used longest ago are removed."""
        calibrations = self._all()
        calibrations.pop(self._key, None)
        while len(calibrations) >= _MAX_CALIBRATIONS:
            del calibrations[next(iter(calibrations))]
        rows = {name: {"value": one.value, "scatter": one.scatter} for name, one in sorted(references.items())}
        calibrations[self._key] = {"learned_ns": t_ns, "observables": rows}
        data = json.dumps({"version": 1, "calibrations": calibrations}, indent=1).encode()
        self._write(lambda: write_atomically(self.references_file, data))

    def append(self, row: Mapping[str, Any]) -> None:
        """Append a line to the history."""
        self._write(lambda: self._append(json.dumps(row, separators=(",", ":")).encode() + b"\n"))

    def _append(self, line: bytes) -> None:
        path = self.history_file
        if path.exists() and path.stat().st_size + len(line) > MAX_HISTORY_BYTES:
            path.replace(path.with_name("history.1.jsonl"))
        with path.open("ab") as file:
            file.write(line)

    def _all(self) -> dict[str, Any]:
        if not self.references_file.exists():
            return {}
        try:
            data = json.loads(read_at_most(self.references_file, _MAX_REFERENCES_BYTES, DaemonError))
            return dict(data["calibrations"])
        except (DaemonError, ValueError, KeyError, TypeError) as error:
            log.warning(
                "self-check: %s cannot be read, the reference is learned again: %s", self.references_file, error
            )
            return {}

    def _write(self, write: Callable[[], object]) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            write()
            self._refused = False
        except OSError as error:
            if not self._refused:
                self._refused = True
                log.warning("self-check: cannot write to %s: %s; see selfcheck.dir", self.directory, error)
