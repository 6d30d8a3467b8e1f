"""Open3D reads every part of PLY and PCD files, and the meshes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from daemon.apps.export.cloud_files import cloud_bytes
from daemon.apps.export.mesh import faces_of
from fringed.parts import PARTS
from tests.daemon.apps.export.test_export import valid
from tests.daemon.apps.export.test_parts import surface

READER = Path(__file__).with_name("open3d_reader.py")
PYTHON = READER.parents[4] / ".open3d-venv" / "bin" / "python"
"""Made by ``make test-all``."""

pytestmark = pytest.mark.long


def read_by_open3d(data: bytes, kind: str, folder: Path) -> dict[str, np.ndarray]:
    """What Open3D found in a file."""
    given, out = folder / f"given.{kind}", folder / "out.npz"
    given.write_bytes(data)
    subprocess.run([PYTHON, READER, given, out], check=True, timeout=100, capture_output=True)
    with np.load(out) as arrays:
        return dict(arrays)


@pytest.mark.parametrize("kind", ["ply", "pcd"])
@pytest.mark.parametrize("parts", [tuple(PARTS), ("xyz",), None])
def test_open3d_reads_every_part_of_a_cloud(kind: str, parts: tuple[str, ...] | None, tmp_path: Path) -> None:
    cloud, known = surface(), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None and cloud.interpolated is not None
    read = read_by_open3d(cloud_bytes(cloud, kind, parts), kind, tmp_path)
    expected = {"positions": cloud.xyz[known]}
    if parts is None or "rgb" in parts:
        color = cloud.rgb if parts else np.repeat(cloud.gray[..., None], 3, axis=-1)
        expected["colors"] = color[known]
    if parts and "normals" in parts:
        expected["normals"] = np.nan_to_num(cloud.normals[known])
        expected |= {"sigma": cloud.sigma_mm[known][:, None], "interpolated": cloud.interpolated[known][:, None]}
    assert set(read) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(read[name], values, err_msg=name)


@pytest.mark.parametrize("kind", ["mesh.ply", "glb"])
def test_open3d_reads_meshes(kind: str, tmp_path: Path) -> None:
    cloud, known = surface(), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None
    read = read_by_open3d(cloud_bytes(cloud, kind, tuple(PARTS)), kind, tmp_path)
    # Open3D renumbers the points of a GLB: corners are compared, triangle by triangle.
    given, faces = read["triangles"], faces_of(cloud.xyz)
    np.testing.assert_array_equal(np.rint(read["colors"] * 255)[given], cloud.rgb[known][faces])
    # GLB is in metres with y upwards, by the matrix of the file's node.
    turn = np.array([1000, -1000, -1000]) if kind == "glb" else np.ones(3)
    np.testing.assert_allclose((read["positions"] * turn)[given], cloud.xyz[known][faces], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(
        (read["normals"] * np.sign(turn))[given], np.nan_to_num(cloud.normals[known])[faces], atol=1e-5
    )
