"""Which settings can change while the daemon measures; all others need a restart."""

from __future__ import annotations

LIVE: tuple[str, ...] = (
    "calibration",
    "volume",
    "mode",
    "pairing.*",
    "pipeline.overload",
    "pipeline.temporal_prior",
    "pipeline.settings.*",
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
"""Paths, or sections with ``.*``. Who takes one over is a sink (:class:`daemon.live.items.Changeable`), or reads the
service's ``config`` anew each time."""

FILES = ("calibration", "pattern", "volume")
"""Settings that name a file, whose content counts like a setting."""


BY_FILE = ("calibration", "recording.dir")
"""Places on the disk are the business of whoever writes rig.yaml: they change live by a reload, not by `set`."""


def is_live(path: str) -> bool:
    """Whether a setting can change while the daemon measures."""
    return any(
        path == entry or (entry.endswith(".*") and (path + ".").startswith(entry.removesuffix("*"))) for entry in LIVE
    )
