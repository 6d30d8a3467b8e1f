"""Every kind of file with every part, read back by this test's own readers and by trimesh."""

from __future__ import annotations

import io
import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name, read_cloud
from daemon.apps.export.mesh import faces_of
from daemon.cli.entry import run
from fringed.parts import PARTS
from pipeline.attributes.normals import normals_of
from pipeline.reconstruct.reconstructor import Reconstructor
from tests.daemon.apps.export.test_export import read_ply, valid
from tests.daemon.recording import small_take


def surface(height: int = 30, width: int = 40, seed: int = 0) -> SavedCloud:
    """A wave with holes, with every part."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    xyz = np.stack([u, v, 1000 + 2 * np.sin(u / 5)], axis=-1).astype(np.float32)
    sigma = rng.uniform(0.01, 0.1, (height, width)).astype(np.float32)
    xyz[5:9, 10:20], sigma[5:9, 10:20] = np.nan, np.nan
    gray, rgb = rng.integers(0, 256, (height, width), np.uint8), rng.integers(0, 256, (height, width, 3), np.uint8)
    cloud = SavedCloud(xyz, sigma, gray, rgb, interpolated=rng.random((height, width)) < 0.2)
    return cloud.completed(["normals"], "it")


def read_pcd(data: bytes) -> np.ndarray:
    head, _, body = data.partition(b"DATA binary\n")
    keys = dict(line.split(" ", 1) for line in head.decode("ascii").splitlines() if not line.startswith("#"))
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(keys["TYPE"].split(), keys["SIZE"].split(), strict=True)]
    return np.frombuffer(body, np.dtype(list(zip(keys["FIELDS"].split(), kinds, strict=True))))


def test_npz_keeps_every_part_exactly(tmp_path: Path) -> None:
    cloud = surface()
    path = tmp_path / cloud_name(1, "npz")
    path.write_bytes(cloud_bytes(cloud, "npz", tuple(PARTS)))
    back = read_cloud(path)
    for name in ("xyz", "sigma_mm", "gray", "rgb", "normals", "interpolated"):
        np.testing.assert_array_equal(getattr(back, name), getattr(cloud, name))
    path.write_bytes(cloud_bytes(cloud, "npz", ("xyz",)))
    with np.load(path) as arrays:
        assert set(arrays) == {"xyz", "sigma_mm", "gray"}


def test_ply_has_a_property_for_every_part() -> None:
    cloud = surface()
    rows, known = read_ply(cloud_bytes(cloud, "ply", tuple(PARTS))), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None and cloud.interpolated is not None
    np.testing.assert_array_equal(np.stack([rows[name] for name in "xyz"], -1), cloud.xyz[known])
    np.testing.assert_array_equal(np.stack([rows[name] for name in ("red", "green", "blue")], -1), cloud.rgb[known])
    normals = np.stack([rows[name] for name in ("nx", "ny", "nz")], -1)
    np.testing.assert_array_equal(normals, np.nan_to_num(cloud.normals[known]))
    np.testing.assert_array_equal(rows["sigma"], cloud.sigma_mm[known])
    np.testing.assert_array_equal(rows["interpolated"], cloud.interpolated[known])


def test_pcd_has_a_field_for_every_part() -> None:
    cloud = surface()
    rows, known = read_pcd(cloud_bytes(cloud, "pcd", tuple(PARTS))), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None and cloud.interpolated is not None
    np.testing.assert_array_equal(np.stack([rows[name] for name in "xyz"], -1), cloud.xyz[known])
    packed = np.ascontiguousarray(rows["rgb"]).view(np.uint32)
    np.testing.assert_array_equal(np.stack([packed >> s & 255 for s in (16, 8, 0)], -1), cloud.rgb[known])
    normals = np.stack([rows[f"normal_{name}"] for name in "xyz"], -1)
    np.testing.assert_array_equal(normals, np.nan_to_num(cloud.normals[known]))
    np.testing.assert_array_equal(rows["sigma"], cloud.sigma_mm[known])
    np.testing.assert_array_equal(rows["interpolated"], cloud.interpolated[known])


@pytest.mark.parametrize("kind", ["ply", "pcd"])
def test_without_parts_the_file_is_as_it_always_was(kind: str) -> None:
    cloud = surface()
    plain = SavedCloud(cloud.xyz, cloud.sigma_mm, cloud.gray)
    assert cloud_bytes(cloud, kind) == cloud_bytes(plain, kind) == cloud_bytes(cloud, kind, ("xyz", "gray"))


@pytest.mark.parametrize("kind", ["ply", "mesh.ply"])
def test_trimesh_reads_ply_with_everything(kind: str) -> None:
    cloud, known = surface(), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None
    made = trimesh.load(io.BytesIO(cloud_bytes(cloud, kind, tuple(PARTS))), file_type="ply", process=False)
    np.testing.assert_array_equal(made.vertices, cloud.xyz[known])
    np.testing.assert_array_equal(made.visual.vertex_colors[:, :3] if kind == "mesh.ply" else made.colors[:, :3],
                                  cloud.rgb[known])  # fmt: skip
    rows = made.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(rows["nx"], np.nan_to_num(cloud.normals[known][:, 0]))
    np.testing.assert_array_equal(rows["sigma"], cloud.sigma_mm[known])
    if kind == "mesh.ply":
        np.testing.assert_array_equal(made.faces, faces_of(cloud.xyz))


def glb_accessors(data: bytes) -> dict[str, np.ndarray]:
    """Attributes of the only mesh of a GLB file, and its node's matrix, read by the letter of glTF 2.0."""
    magic, version, _ = struct.unpack("<4sII", data[:12])
    size = struct.unpack("<I", data[12:16])[0]
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    assert (magic, version) == (b"glTF", 2)
    kinds, counts = {5126: "<f4", 5121: "|u1", 5125: "<u4"}, {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

    def array(number: int) -> np.ndarray:
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        shape = accessor["count"], counts[accessor["type"]]
        return np.frombuffer(binary, kinds[accessor["componentType"]], shape[0] * shape[1], start).reshape(shape)

    (primitive,) = document["meshes"][0]["primitives"]
    (matrix,) = [node["matrix"] for node in document["nodes"] if "matrix" in node]
    found = {name: array(number) for name, number in primitive["attributes"].items()}
    return found | {"faces": array(primitive["indices"]).reshape(-1, 3), "matrix": np.array(matrix).reshape(4, 4).T}


def test_glb_has_an_attribute_for_every_part() -> None:
    cloud, known = surface(), valid(surface())
    assert cloud.rgb is not None and cloud.normals is not None and cloud.interpolated is not None
    data = cloud_bytes(cloud, "glb", tuple(PARTS))
    found = glb_accessors(data)
    np.testing.assert_array_equal(found["POSITION"], cloud.xyz[known])
    np.testing.assert_array_equal(found["COLOR_0"][:, :3], cloud.rgb[known])
    np.testing.assert_allclose(found["NORMAL"], np.nan_to_num(cloud.normals[known]), atol=1e-6)
    np.testing.assert_array_equal(found["_SIGMA"].ravel(), cloud.sigma_mm[known])
    np.testing.assert_array_equal(found["_INTERPOLATED"].ravel(), cloud.interpolated[known])
    np.testing.assert_array_equal(found["faces"], faces_of(cloud.xyz))
    np.testing.assert_allclose(found["matrix"] @ [1000, 2000, 3000, 1], [1, -2, -3, 1])
    scene = trimesh.load(io.BytesIO(data), file_type="glb", process=False)
    np.testing.assert_allclose(scene.to_geometry().vertices, cloud.xyz[known] * [1e-3, -1e-3, -1e-3], atol=1e-6)


def test_a_mesh_covers_the_surface_faces_the_camera_and_joins_no_two_surfaces() -> None:
    v, u = np.mgrid[:20, :30].astype(np.float32)
    xyz = np.stack([u, v, 1000 + 0 * u], axis=-1).astype(np.float32)
    xyz[:, 15:, 2] += 50
    faces, points = faces_of(xyz), xyz.reshape(-1, 3)
    corners = points[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert (area[:, 2] < 0).all()
    assert -area[:, 2].sum() == 19 * (14 + 14)
    assert np.ptp(corners[..., 2], axis=1).max() == 0
    xyz[10, 5] = np.nan
    assert len(faces) - len(faces_of(xyz)) in (4, 5, 6)  # four squares lose a corner: one triangle of each stays
    assert len(faces_of(np.full_like(xyz, np.nan))) == 0


def test_normals_of_a_file_are_computed_and_its_color_is_not_invented(tmp_path: Path) -> None:
    cloud = replace(surface(), rgb=None, normals=None, interpolated=None)
    clouds, out = tmp_path / "clouds", tmp_path / "out"
    clouds.mkdir()
    (clouds / cloud_name(3, "npz")).write_bytes(cloud_bytes(cloud, "npz"))
    assert run(["export", str(clouds), "--out", str(out), "--parts", "xyz,normals,interpolated"]) == 0
    rows = read_ply((out / "cloud_000003.ply").read_bytes())
    expected = np.nan_to_num(normals_of(cloud.xyz, cloud.sigma_mm)[valid(cloud)])
    np.testing.assert_array_equal(np.stack([rows[name] for name in ("nx", "ny", "nz")], -1), expected)
    assert not rows["interpolated"].any() and "red" not in rows.dtype.names
    assert run(["export", str(clouds), "--out", str(out), "--parts", "xyz,rgb"]) == 2


@pytest.mark.parametrize("command", ["export", "replay", "listen"])
@pytest.mark.parametrize(
    ("parts", "message"),
    [("nonsense", "there is no part 'nonsense'"), ("", "names no part"), ("xyz,xyz", "2 times, limit 1")],
)
def test_wrong_parts_end_with_status_two(
    command: str, parts: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.npz").write_bytes(cloud_bytes(surface(), "npz"))
    source = [] if command == "listen" else [str(tmp_path / "x.npz"), "--out", str(tmp_path / "out")]
    assert run([command, *source, "--parts", parts]) == 2
    assert "--parts" in (shown := capsys.readouterr().err) and message in shown
    assert not (tmp_path / "out").exists()


def test_clouds_of_another_export_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clouds, out = tmp_path / "clouds", tmp_path / "out"
    clouds.mkdir()
    (clouds / cloud_name(3, "npz")).write_bytes(cloud_bytes(surface(), "npz"))
    assert run(["export", str(clouds), "--out", str(out)]) == 0
    assert run(["export", str(clouds), "--out", str(out)]) == 0
    assert "not of this export" not in capsys.readouterr().err
    (clouds / cloud_name(3, "npz")).rename(clouds / cloud_name(4, "npz"))
    assert run(["export", str(clouds), "--out", str(out)]) == 0
    assert "1 clouds there are not of this export: cloud_000003.ply" in capsys.readouterr().err


@pytest.fixture(scope="module")
def images() -> list[small_take.Images]:
    return small_take.render()


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory, images: list[small_take.Images]) -> Path:
    return small_take.write(tmp_path_factory.mktemp("takes") / "take.mcap", images)


def test_takes_give_color_and_normals_of_their_images(take: Path, images: Any, tmp_path: Path) -> None:
    parts = "xyz,sigma,rgb,normals"
    assert run(["replay", str(take), "--out", str(tmp_path / "npz"), "--parts", parts]) == 0
    calibration = small_take.LAYOUT.calibration_for(small_take.OPTICS)
    reconstructor = Reconstructor(calibration, small_take.LAYOUT.pattern(), small_take.LAYOUT.volume())
    saved = sorted((tmp_path / "npz").glob("*.npz"))
    for path, (left, _) in zip(saved, images, strict=True):
        cloud = read_cloud(path)
        np.testing.assert_array_equal(cloud.rgb, reconstructor.color(left))
        np.testing.assert_array_equal(cloud.normals, normals_of(cloud.xyz, cloud.sigma_mm))
    # The same from the take and from the saved clouds, and a directory of takes is exported wholly.
    folder = tmp_path / "takes"
    folder.mkdir()
    for name in ("one", "two"):
        shutil.copy(take, folder / f"{name}.mcap")
    for source, out in ((tmp_path / "npz", tmp_path / "from_npz"), (folder, tmp_path / "from_takes")):
        assert run(["export", str(source), "--out", str(out), "--format", "mesh.ply", "--parts", parts]) == 0
    expected = {path.name: path.read_bytes() for path in (tmp_path / "from_npz").iterdir()}
    assert len(expected) == len(images)
    for name in ("one", "two"):
        assert {path.name: path.read_bytes() for path in (tmp_path / "from_takes" / name).iterdir()} == expected
