"""The Point Cloud Library reads every part of PCD and PLY files; its programs write them as text."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from daemon.apps.export.cloud_files import cloud_bytes
from fringed.parts import PARTS
from tests.daemon.apps.export.test_export import valid
from tests.daemon.apps.export.test_parts import surface

PROGRAMS = {"pcd": ("pcl_convert_pcd_ascii_binary", "{given}", "{text}", "0"),
            "ply": ("pcl_ply2pcd", "-format", "0", "{given}", "{text}"),
            "mesh.ply": ("pcl_ply2pcd", "-format", "0", "{given}", "{text}")}  # fmt: skip


def read_by_pcl(data: bytes, kind: str, folder: Path) -> dict[str, np.ndarray]:
    """Fields of a cloud file as the library reads them, float64."""
    given, text = folder / f"given.{kind}", folder / "text.pcd"
    given.write_bytes(data)
    command = [part.format(given=given, text=text) for part in PROGRAMS[kind]]
    subprocess.run(command, check=True, timeout=60, capture_output=True)
    lines = text.read_text().splitlines()
    head = dict(line.split(" ", 1) for line in lines[1:11])
    rows = np.loadtxt(lines[11:], ndmin=2)
    assert head["DATA"] == "ascii" and len(rows) == int(head["POINTS"])
    return dict(zip(head["FIELDS"].split(), rows.T, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("kind", PROGRAMS)
@pytest.mark.parametrize("parts", [tuple(PARTS), ("xyz", "rgb"), ("xyz", "normals"), ("xyz",), None])
def test_the_point_cloud_library_reads_the_same_numbers(
    kind: str, parts: tuple[str, ...] | None, tmp_path: Path
) -> None:
    cloud, known = surface(), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None and cloud.interpolated is not None
    read = read_by_pcl(cloud_bytes(cloud, kind, parts), kind, tmp_path)
    expected = {axis: cloud.xyz[known][:, k] for k, axis in enumerate("xyz")}
    color = cloud.rgb if parts and "rgb" in parts else np.repeat(cloud.gray[..., None], 3, axis=-1)
    if parts is None or "rgb" in parts:
        expected["rgb"] = color[known].astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    if parts and "normals" in parts:
        for k, axis in enumerate("xyz"):
            expected[f"normal_{axis}"] = np.nan_to_num(cloud.normals[known][:, k])
    if parts and "sigma" in parts:
        expected |= {"sigma": cloud.sigma_mm[known], "interpolated": cloud.interpolated[known]}
    assert set(read) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(read[name], values, rtol=1e-6, atol=1e-7, err_msg=name)
