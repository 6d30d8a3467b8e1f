from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from daemon.common.files import write_atomically
from daemon.rig.calibration_file import SIZE_LIMIT, parse_calibration, read_calibration, write_calibration
from daemon.rig.pattern_file import parse_pattern, parse_volume, read_pattern
from pipeline.common.errors import CalibrationError, PatternError, PipelineError
from pipeline.rig.calibration import from_mapping


def mapping() -> dict[str, Any]:
    device: dict[str, Any] = {
        "size": [64, 48],
        "matrix": [[100.0, 0.5, 31.5], [0, 101.0, 23.5], [0, 0, 1]],
        "distortion": [0.01, -0.02, 0.001, 0.002, 0.0],
        "rotation": np.eye(3).tolist(),
        "translation": [0.0, 0.0, 0.0],
    }
    right = device | {"translation": [-200.0, 0.0, 0.0], "serial": "B 7"}
    projector = device | {"translation": [-80.0, 0.0, 0.0]}
    return {"fringed_calibration": 1, "cameras": {"left": device, "right": right}, "projector": projector}


def test_a_file_comes_back_with_its_identity_and_unknown_keys(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    old = mapping() | {"operator": {"name": "somebody"}, "quality": {"rms_px": 9.0, "old": True}}
    when = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)
    calibration = from_mapping(mapping())
    written = write_calibration(path, calibration, created=when, quality={"rms_px": 0.1}, keep=old)
    file = read_calibration(path)
    assert file.identity == written.identity == f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
    assert file.mapping["operator"] == {"name": "somebody"}
    assert file.mapping["quality"] == {"rms_px": 0.1}
    assert file.mapping["cameras"]["right"]["serial"] == "B 7"
    assert b"created: '2026-11-20T12:00:00Z'" in file.data or b"created: 2026-11-20T12:00:00Z" in file.data
    for name in ("left", "right", "projector"):
        before, after = getattr(calibration, name), getattr(file.calibration, name)
        np.testing.assert_array_equal(after.matrix, before.matrix)
        np.testing.assert_array_equal(after.distortion, before.distortion)
        np.testing.assert_array_equal(after.translation, before.translation)


def test_dates_may_be_dates_or_text() -> None:
    for created in ("2026-11-20T12:00:00Z", "'2026-11-20T12:00:00Z'"):
        parse_calibration(f"created: {created}\n{yaml.safe_dump(mapping())}".encode(), "c.yaml")


def edited(*path: str, value: Any) -> bytes:
    data = mapping()
    inner: Any = data
    for key in path[:-1]:
        inner[key] = dict(inner[key])
        inner = inner[key]
    inner[path[-1]] = value
    return yaml.safe_dump(data).encode()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"fringed_calibration: 1\ncameras: [1, 2\n", r"rig7/c\.yaml:3:1: "),
        (b"fringed_calibration: 1\ncameras: {}\nfringed_calibration: 1\n", r"c\.yaml:3:1: the key .* twice"),
        (b"\xff\xfe\x00bad", r"c\.yaml"),
        (b"a: \x07\n", r"c\.yaml"),
        (b"!!python/object/apply:os.system ['true']\n", r"c\.yaml:1:1: "),
        (b"- 1\n", r"c\.yaml: expected keys and values"),
        (b"", r"c\.yaml: expected keys and values"),
        (edited("fringed_calibration", value=2), r"c\.yaml: fringed_calibration is 2"),
        (edited("cameras", "left", "size", value=[64]), r"c\.yaml: cameras\.left\.size"),
        (edited("cameras", "right", "rotation", value=[[1, 0, 0], [0, 2, 0], [0, 0, 1]]), r"cameras\.right|right\.rot"),
        (edited("cameras", "right", "matrix", value="none"), r"c\.yaml: cameras\.right\.matrix"),
        (edited("cameras", "left", "size", value=[float("inf"), 3]), r"c\.yaml: "),
        (edited("projector", "distortion", value=[0, 0]), r"c\.yaml: projector\.distortion"),
        (b"[" * 5000, r"c\.yaml"),
        (b"[" * 300_000, r"c\.yaml: nested too deeply"),
    ],
)
def test_invalid_files_are_reported_with_their_line(data: bytes, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        parse_calibration(data, "rig7/c.yaml")


def test_small_texts_that_expand_to_huge_ones_are_rejected() -> None:
    lines = ["fringed_calibration: 1", "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    lines += ["cameras: {left: {size: *a11}, right: {}}", "projector: {}"]
    with pytest.raises(CalibrationError, match=r"c\.yaml"):
        parse_calibration("\n".join(lines).encode(), "c.yaml")


def test_a_value_that_contains_itself_is_rejected() -> None:
    with pytest.raises(CalibrationError, match="aliases"):
        parse_calibration(b"fringed_calibration: 1\ncameras: &a [*a]\n", "c.yaml")


def test_huge_and_missing_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    with pytest.raises(CalibrationError, match=r"c\.yaml: No such file"):
        read_calibration(path)
    path.write_bytes(b"#" * (SIZE_LIMIT + 1))
    with pytest.raises(CalibrationError, match="larger than"):
        read_calibration(path)


def test_invalid_patterns_and_volumes_are_reported_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(PatternError, match=r"p\.json:1:10: "):
        parse_pattern(b'{"kind": }', "p.json")
    with pytest.raises(PatternError, match=r"p\.json: pattern\.kind"):
        parse_pattern(b"{}", "p.json")
    with pytest.raises(PatternError, match=r"p\.json: expected a JSON object"):
        parse_pattern(b"[]", "p.json")
    with pytest.raises(PatternError, match="No such file"):
        read_pattern(tmp_path / "p.json")
    assert parse_volume(b'{"near_mm": 1200, "far_mm": 1700}', "v.json").near_mm == 1200
    for bad in (b'{"near_mm": 1}', b'{"near_mm": "1", "far_mm": 2}', b'{"near_mm": 3, "far_mm": 2}', b"\xff"):
        with pytest.raises(PipelineError, match=r"^v\.json"):
            parse_volume(bad, "v.json")


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def refuse(*_: object) -> None:
        raise OSError("full")

    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(OSError, match="full"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
