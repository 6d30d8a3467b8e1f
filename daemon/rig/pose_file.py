"""The output frame: a pose file, such as a hand-eye calibration writes, or the matrix in rig.yaml.

A pose file is YAML or JSON: ``fringed_pose: 1``, ``frame`` (name of the frame that points are transformed into) and
``matrix``, the four rows of the rigid 4 x 4 matrix of X_frame = M X_left, in millimetres. Other keys are ignored.
"""

from __future__ import annotations

import re
from pathlib import Path

from daemon.common.files import read_at_most
from daemon.config.rig_config import RigConfig
from daemon.config.yaml_source import read_yaml
from pipeline.common.errors import CalibrationError
from pipeline.rig.pose import Pose

POSE_LIMIT = 1 << 16
OUTPUT = "output"
"""Name of the frame of a matrix in rig.yaml."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/-]{0,63}")


def read_pose(path: Path) -> Pose:
    """Read a pose file; CalibrationError names the file, the value and the limit."""
    data = read_at_most(path, POSE_LIMIT, CalibrationError)
    try:
        source = read_yaml(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: not UTF-8 text (byte {error.start})") from error
    if source.problems:
        first = source.problems[0]
        raise CalibrationError(f"{path}:{first.line}:{first.column}: {first.message}")
    values = source.data
    if not isinstance(values, dict) or "matrix" not in values:
        raise CalibrationError(f"{path}: not a pose file; it needs the keys fringed_pose: 1, frame and matrix")
    version, frame = values.get("fringed_pose"), values.get("frame", OUTPUT)
    if version != 1:
        raise CalibrationError(f"{path}: fringed_pose is {version!r:.40}, this release reads version 1")
    if not isinstance(frame, str) or not _NAME.fullmatch(frame):
        raise CalibrationError(f"{path}: frame is {frame!r:.80}; a name has 1 to 64 letters, digits or . _ / -")
    return Pose.of_matrix(values["matrix"], frame, name=f"{path}: matrix")


def output_pose(config: RigConfig, base_dir: Path) -> Pose | None:
    """The pose of ``outputs.frame``; None for the left camera's frame."""
    given = config.outputs.frame
    if given is None:
        return None
    if isinstance(given, str):
        return read_pose(config.path(given, base_dir))
    return Pose.of_matrix(given, OUTPUT, name="outputs.frame")
