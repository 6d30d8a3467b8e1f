"""Writing of calibration files: the old one is kept under its date, a better one is replaced only by ``force``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daemon.apps.calibration.errors import KeptError
from daemon.common.files import read_at_most, write_atomically
from daemon.rig.calibration_file import SIZE_LIMIT, CamerasFile, calibration_bytes, parse_cameras
from daemon.rig.camera_serials import Serials
from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Calibration, Cameras

WORSE_BY = 1.1
"""Growth of an error by less than a tenth is chance: another set of views varies as much."""
FLOOR_PX = 0.01
"""Smaller differences have no effect on measurements."""
FLOOR_RAD = 0.002
COVERAGE_BY = 0.1
_ERRORS = {
    "rms_stereo_px": "the marks' reprojection error",
    "epipolar_px": "the epipolar error",
    "rms_projector_px": "the projector's reprojection error",
}


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A written calibration.

    Args:
        path: of the file; identity: hash of its bytes.
        kept: the copy of the previous file, None if there was none.
        notes: whole sentences for the user.
    """

    path: Path
    identity: str
    kept: Path | None = None
    notes: list[str] = field(default_factory=list)


def existing(path: Path) -> CamerasFile | None:
    """The calibration at a path, None if there is no file; CalibrationError for a file that is no calibration."""
    return parse_cameras(read_at_most(path, SIZE_LIMIT, CalibrationError), str(path)) if path.exists() else None


def better_reasons(new: Mapping[str, Any], old: CamerasFile, *, loses_projector: bool) -> list[str]:
    """Reasons why the old calibration is better than the new one; empty if it is not.

    Errors in pixels and coverage are compared together, because errors decrease when the marks lie only in the middle
    of the image. Missing figures of the old file are not compared, but known quality is better than unknown quality.
    """
    before = old.mapping.get("quality")
    before = before if isinstance(before, Mapping) else {}
    reasons = []
    for key, name in _ERRORS.items():
        was, now = _number(before, key), _number(new, key)
        if was is not None and now is not None and now > max(WORSE_BY * was, was + FLOOR_PX):
            reasons.append(f"{name} would grow from {was:.3f} to {now:.3f} px")
    for side in ("left", "right"):
        was, now = _number(before, f"coverage_{side}"), _number(new, f"coverage_{side}")
        if was is not None and now is not None and now < was - COVERAGE_BY:
            reasons.append(f"the marks would cover {100 * now:.0f} % instead of {100 * was:.0f} % of the {side} image")
    for side in ("left", "right"):
        was, now = _phase_error(before, side), _phase_error(new, side)
        if was is not None and now is not None and now > max(WORSE_BY * was, was + FLOOR_RAD):
            reasons.append(f"the {side} phase error would grow from {was:.4f} to {now:.4f} rad")
    if _number(before, "rms_stereo_px") is not None and _number(new, "rms_stereo_px") is None:
        reasons.append("its errors are known, those of the new one are not")
    if loses_projector:
        reasons.append("it has a projector, the new one has none and cannot measure")
    return reasons


def store(
    path: Path,
    calibration: Calibration | Cameras,
    *,
    quality: Mapping[str, Any],
    force: bool = False,
    created: datetime | None = None,
    serials: Serials | None = None,
) -> StoredCalibration:
    """Write a calibration; the replaced file is kept beside it under its date.

    Unknown keys of the old file are carried over, and the cameras' serial numbers unless ``serials`` has others.

    Raises:
        KeptError: the old one is better and ``force`` is not given; no file was changed.
        CalibrationError: the existing file is no calibration and ``force`` is not given.
    """
    created = (created or datetime.now(UTC)).astimezone(UTC)
    old, notes = reject_worse(path, calibration, quality=quality, force=force)
    data = calibration_bytes(
        calibration, created=created, quality=quality, keep=old.mapping if old else None, serials=serials
    )
    file = parse_cameras(data, str(path))
    kept = keep_dated(path, old) if path.exists() else None
    write_atomically(path, data)
    return StoredCalibration(path, file.identity, kept, notes)


def reject_worse(
    path: Path, calibration: Calibration | Cameras, *, quality: Mapping[str, Any], force: bool
) -> tuple[CamerasFile | None, list[str]]:
    """The existing calibration and notes; raise KeptError or CalibrationError as :func:`store` does."""
    try:
        old = existing(path)
    except CalibrationError as error:
        if not force:
            raise CalibrationError(f"{error}; the file is unchanged, --force moves it aside") from error
        return None, [f"{path} was no readable calibration"]
    if old is None:
        return None, []
    loses = old.cameras.projector is not None and calibration.projector is None
    reasons = better_reasons(quality, old, loses_projector=loses)
    if reasons and not force:
        raise KeptError(
            f"{path} is better and was not replaced: {'; '.join(reasons)}. Write elsewhere with --out, or replace it "
            "with --force"
        )
    return old, [f"replaced by --force although {reason}" for reason in reasons]


def keep_dated(path: Path, old: CamerasFile | None) -> Path:
    """Copy a file to ``NAME.2026-11-21T120000Z.yaml`` beside it, with its own date; return the copy's path."""
    data = path.read_bytes()
    stamp = _stamp(old.mapping.get("created") if old else None, path)
    for number in range(1, 1000):
        more = "" if number == 1 else f"-{number}"
        name = path.with_name(f"{path.stem}.{stamp:%Y-%m-%dT%H%M%SZ}{more}{path.suffix}")
        if not name.exists():
            write_atomically(name, data)
            return name
        if name.read_bytes() == data:
            return name
    raise KeptError(f"{path}: 999 copies with the date of the same second exist; move some of them away")


def _stamp(created: Any, path: Path) -> datetime:
    """The date in a calibration, else the time at which its file was written."""
    try:
        date = created if isinstance(created, datetime) else datetime.fromisoformat(str(created))
        return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)
    except ValueError:
        return datetime.fromtimestamp(path.stat().st_mtime, UTC)


def _phase_error(quality: Mapping[str, Any], side: str) -> float | None:
    """Phase error of one camera with the file's colours."""
    colors = quality.get("color")
    camera = colors.get(side) if isinstance(colors, Mapping) else None
    errors = camera.get("phase_error_rad") if isinstance(camera, Mapping) else None
    return _number({"last": errors[-1]}, "last") if isinstance(errors, list) and errors else None


def _number(quality: Mapping[str, Any], key: str) -> float | None:
    value = quality.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
