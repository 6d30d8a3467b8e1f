"""Which settings can change while the daemon measures; all others need a restart."""

from __future__ import annotations

LIVE: tuple[str, ...] = (
    "calibration",
    "volume",
    "mode",
    "preset",
    "pairing.*",
    "pipeline.overload",
    "pipeline.temporal_prior",
    "pipeline.temporal",
    "pipeline.calibration_check",
    "pipeline.settings.*",
    "outputs.parts",
    "stream.preview_hz",
    "recording.*",
    "selfcheck.rate_hz",
    "selfcheck.limits.*",
    "health.looks_hz",
    "health.window_s",
    "health.raise_s",
    "health.clear_s",
    "health.margin",
    "health.limits.*",
)
"""Paths, or sections with ``.*``. A setting is applied by a sink (:class:`daemon.live.items.Changeable`), or is read
from the service's ``config`` at each use."""

FILES = ("calibration", "pattern", "volume")
"""Settings that name a file whose content counts like a setting."""


BY_FILE = ("calibration", "recording.dir")
"""Settings that name a path on the disk: they change live by a reload of rig.yaml only, not by `set`."""


def is_live(path: str) -> bool:
    """Return whether a setting can change while the daemon measures."""
    return any(
        path == entry or (entry.endswith(".*") and (path + ".").startswith(entry.removesuffix("*"))) for entry in LIVE
    )
