"""Pose files: read as written, mistakes named with file and value."""

from pathlib import Path

import numpy as np
import pytest

from daemon.config.load import parse_rig
from daemon.rig.pose_file import output_pose, read_pose
from pipeline.common.errors import CalibrationError

IDENTITY = "[[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


def test_the_output_frame_is_a_file_or_a_matrix(tmp_path: Path) -> None:
    (tmp_path / "hand.yaml").write_text(f"fringed_pose: 1\nframe: robot_base\nmatrix: {IDENTITY}\nby: me\n")
    from_file = output_pose(
        parse_rig("cameras: {driver: sim}\noutputs: {frame: hand.yaml}", base_dir=tmp_path), tmp_path
    )
    inline = output_pose(parse_rig(f"cameras: {{driver: sim}}\noutputs: {{frame: {IDENTITY}}}"), tmp_path)
    assert from_file is not None and inline is not None
    assert (from_file.frame, inline.frame) == ("robot_base", "output")
    assert np.array_equal(from_file.translation, [5, 0, 0]) and np.array_equal(inline.matrix, from_file.matrix)
    assert output_pose(parse_rig("cameras: {driver: sim}"), tmp_path) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fringed_pose: 2\nmatrix: []\n", "fringed_pose is 2, this release reads version 1"),
        ("fringed_pose: 1\nframe: a b\nmatrix: []\n", "frame is 'a b'"),
        ("near_mm: 3\n", "not a pose file"),
        ("fringed_pose: 1\nmatrix: 3\n", "matrix must be four rows"),
        ("{", "YAML syntax"),
    ],
)
def test_mistakes_are_named_with_the_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "pose.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=rf"pose\.yaml.*{message}"):
        read_pose(tmp_path / "pose.yaml")
