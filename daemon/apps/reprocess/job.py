"""What a run does with every recording; two runs with equal jobs give equal results."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any

from daemon.common.version import program_version
from pipeline.common.settings import Settings
from pipeline.monitor.check.checked_reconstructor import Policy

CLOUD_KINDS = ("npz", "ply", "pcd", "zarr")


def release() -> dict[str, str]:
    """Versions on which the bits of a result depend."""
    return {"fringed": program_version(), "numpy": _version("numpy"), "numba": _version("numba")}


@cache
def _version(name: str) -> str:
    return version(name)


@dataclass(frozen=True, slots=True)
class Job:
    """Arguments of a run.

    Args:
        settings: of the pipeline; calibration: bytes of the file to use instead of the attached ones.
        kind: of the cloud files, or empty for none; calibration_check: policy for pairs that contradict the
            calibration; use_prior, fuse: as of a replay.
        parts: what to write of each cloud, as of ``cloud_bytes``; empty = the default.
        chunk_pairs: pairs of images in a chunk.
        threads: of numba in each worker; no result depends on it.
    """

    settings: Settings = field(default_factory=Settings)
    calibration: bytes | None = None
    kind: str = "npz"
    calibration_check: Policy = "withhold"
    use_prior: bool = False
    parts: tuple[str, ...] = ()
    chunk_pairs: int = 16
    threads: int = 0
    fuse: bool = False
    release: Mapping[str, str] = field(default_factory=release)

    def describe(self) -> dict[str, Any]:
        """All that results depend on, besides the recordings, as plain values."""
        calibration = None if self.calibration is None else f"sha256:{hashlib.sha256(self.calibration).hexdigest()}"
        return {
            "settings": dataclasses.asdict(self.settings),
            "calibration": calibration,
            "format": self.kind,
            "calibration_check": self.calibration_check,
            "follow": self.use_prior,
            "temporal": "fuse" if self.fuse else "off",
            "parts": list(self.parts),
            "release": dict(self.release),
        }

    def changed_settings(self) -> dict[str, Any]:
        """Settings that differ from the defaults."""
        defaults = dataclasses.asdict(Settings())
        return {k: v for k, v in dataclasses.asdict(self.settings).items() if v != defaults[k]}

    def key(self, source: str, attachments: Mapping[str, str]) -> str:
        """Identity of the results of a chunk: of the job, the chunk's frames, and the files attached to the take."""
        used = {n: h for n, h in attachments.items() if not (n == "calibration.yaml" and self.calibration is not None)}
        text = json.dumps([self.describe(), source, used], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()
