"""The files that rig.yaml names, read again: what has changed in them, and whether it can be applied live."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from daemon.common.errors import DaemonError
from daemon.config.rig_config import RigConfig
from daemon.control.settings.live_settings import FILES
from daemon.live.acquisition.camera_status import CameraStatus
from daemon.live.compatibility import size_problem
from daemon.rig.calibration_file import read_calibration
from daemon.rig.camera_serials import serials_in
from daemon.rig.open_rig import Rig
from daemon.rig.pattern_file import read_pattern, read_volume
from drivers.protocols import SIDES, Side
from pipeline.pattern.color_fringe import from_mapping as pattern_from_mapping
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume


def read_again(rig: Rig, config: RigConfig, base_dir: Path, *, names: Collection[str] = FILES) -> Rig:
    """Return the rig with calibration, pattern and volume read again; what no file defines stays.

    Args:
        names: of the files to read.

    Raises:
        PipelineError: a file that cannot be used. OSError: one that cannot be read.
    """
    changes: dict[str, object] = {}
    if config.calibration is not None and "calibration" in names:
        read = read_calibration(config.path(config.calibration, base_dir))
        changes |= {"calibration": read.calibration, "calibration_data": read.data, "identity": read.identity}
        changes["serials"] = serials_in(read.mapping["cameras"])
    if "pattern" not in names:
        pass
    elif isinstance(config.pattern, str):
        changes["pattern"] = read_pattern(config.path(config.pattern, base_dir))
    elif config.pattern is not None:
        changes["pattern"] = pattern_from_mapping(config.pattern)
    if "volume" not in names:
        pass
    elif isinstance(config.volume, str):
        changes["volume"] = read_volume(config.path(config.volume, base_dir))
    elif config.volume is not None:
        changes["volume"] = Volume(config.volume.near_mm, config.volume.far_mm)
    fresh = replace(rig, **changes)  # type: ignore[arg-type]
    return fresh if changed_files(rig, fresh) else rig


def changed_files(old: Rig, new: Rig) -> list[str]:
    """Return which of calibration, pattern and volume differ."""
    same = {
        "calibration": old.identity == new.identity,
        "pattern": old.pattern.as_mapping() == new.pattern.as_mapping(),
        "volume": (old.volume.near_mm, old.volume.far_mm) == (new.volume.near_mm, new.volume.far_mm),
    }
    return [name for name, is_same in same.items() if not is_same]


def needs_restart(old: Rig, new: Rig) -> list[str]:
    """Return the changed files that change the projected image: images of both would be measured for a while."""
    pattern = ["pattern"] if "pattern" in changed_files(old, new) else []
    return pattern if same_light(old.calibration, new.calibration) else ["calibration", *pattern]


def same_light(old: Calibration, new: Calibration) -> bool:
    """Return whether both calibrations drive the projector identically."""
    a, b = old.response, new.response
    if a is None or b is None:
        return a is b
    return np.array_equal(a.levels, b.levels) and np.array_equal(a.curves, b.curves)


def check_fit(new: Rig, cameras: dict[Side, CameraStatus]) -> None:
    """Raise DaemonError where a calibration does not belong to these cameras and this pattern."""
    problems = list(filter(None, (size_problem(side, cameras[side].size, new.calibration) for side in SIDES)))
    if problems:
        raise DaemonError("; ".join(problems))
