"""Exported clouds contain exactly the valid points, and videos are readable."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name, read_cloud
from daemon.apps.export.depth_video import depth_image, depth_limits, write_video
from daemon.apps.export.sources import contents
from daemon.common.errors import DaemonError


def make_cloud(seed: int = 0, height: int = 11, width: int = 14) -> SavedCloud:
    rng = np.random.default_rng(seed)
    xyz = rng.normal(1400, 30, (height, width, 3)).astype(np.float32)
    sigma = rng.uniform(0.01, 0.1, (height, width)).astype(np.float32)
    unknown = rng.random((height, width)) < 0.3
    xyz[unknown], sigma[unknown] = np.nan, np.nan
    return SavedCloud(xyz, sigma, rng.integers(0, 256, (height, width), dtype=np.uint8))


def valid(cloud: SavedCloud) -> np.ndarray:
    return np.isfinite(cloud.xyz[..., 2])


def read_ply(data: bytes) -> np.ndarray:
    head, _, body = data.partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    kinds = {"float": "<f4", "uchar": "|u1"}
    fields = [(line.split()[2], kinds[line.split()[1]]) for line in lines if line.startswith("property")]
    rows = np.frombuffer(body, np.dtype(fields))
    assert len(rows) == count
    return rows


def read_pcd(data: bytes) -> np.ndarray:
    head, _, body = data.partition(b"DATA binary\n")
    keys = dict(line.split(" ", 1) for line in head.decode("ascii").splitlines() if not line.startswith("#"))
    assert (keys["VERSION"], keys["TYPE"], keys["SIZE"], keys["HEIGHT"]) == ("0.7", "F F F F", "4 4 4 4", "1")
    assert keys["WIDTH"] == keys["POINTS"]
    rows = np.frombuffer(body, np.dtype([(name, "<f4") for name in keys["FIELDS"].split()]))
    assert len(rows) == int(keys["POINTS"])
    return rows


def test_ply_contains_the_valid_points_with_their_gray() -> None:
    cloud = make_cloud()
    rows = read_ply(cloud_bytes(cloud, "ply"))
    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], axis=-1), cloud.xyz[valid(cloud)])
    for channel in ("red", "green", "blue"):
        np.testing.assert_array_equal(rows[channel], cloud.gray[valid(cloud)])


def test_pcd_contains_the_valid_points_with_their_gray() -> None:
    cloud = make_cloud(1)
    rows = read_pcd(cloud_bytes(cloud, "pcd"))
    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], axis=-1), cloud.xyz[valid(cloud)])
    packed = np.ascontiguousarray(rows["rgb"]).view(np.uint32)
    for shift in (0, 8, 16):
        np.testing.assert_array_equal(packed >> shift & 255, cloud.gray[valid(cloud)])


def test_npz_round_trip_is_exact_and_the_bytes_repeat(tmp_path: Path) -> None:
    cloud = make_cloud(2)
    data = cloud_bytes(cloud, "npz")
    assert data == cloud_bytes(cloud, "npz")
    path = tmp_path / cloud_name(7, "npz")
    path.write_bytes(data)
    back = read_cloud(path)
    for name in ("xyz", "sigma_mm", "gray"):
        np.testing.assert_array_equal(getattr(back, name), getattr(cloud, name))
    assert contents(tmp_path).clouds == [path]


def test_names_have_six_digits_and_sort_by_number(tmp_path: Path) -> None:
    assert cloud_name(42, "ply") == "cloud_000042.ply"
    for sequence in (1_000_000, 3, 20):
        (tmp_path / cloud_name(sequence, "npz")).touch()
    assert [path.name for path in contents(tmp_path).clouds] == [cloud_name(n, "npz") for n in (3, 20, 1_000_000)]


def test_an_unknown_format_is_named() -> None:
    with pytest.raises(DaemonError, match="'obj', expected one of: npz, ply, pcd"):
        cloud_bytes(make_cloud(), "obj")


def test_damaged_cloud_files_are_rejected_by_name(tmp_path: Path) -> None:
    whole = cloud_bytes(make_cloud(3), "npz")
    path = tmp_path / cloud_name(0, "npz")
    rng = np.random.default_rng(5)
    read = 0
    for cut in rng.integers(0, len(whole), 25):
        path.write_bytes(whole[:cut])
        with pytest.raises(DaemonError, match="cloud_000000"):
            read_cloud(path)
    for at in rng.integers(0, len(whole), 50):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            back = read_cloud(path)
        except DaemonError as error:
            assert "cloud_000000" in str(error)
            continue
        read += 1
        np.testing.assert_array_equal(back.xyz, make_cloud(3).xyz)
    assert read < 50


def test_a_file_of_other_arrays_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / cloud_name(0, "npz")
    np.savez(path, xyz=np.zeros((2, 2, 3)), sigma_mm=np.zeros((2, 2), np.float32), gray=np.zeros((2, 2), np.uint8))
    with pytest.raises(DaemonError, match="xyz is float64"):
        read_cloud(path)
    np.savez(path, xyz=np.array([object()]), sigma_mm=np.zeros(1), gray=np.zeros(1))
    with pytest.raises(DaemonError, match="not a cloud"):
        read_cloud(path)


def test_near_and_far_have_different_colours_and_invalid_is_black() -> None:
    depth = np.array([[1000.0, 1500.0, np.nan, 900.0, 1600.0]], np.float32)
    near, far, unknown, nearer, farther = depth_image(depth, 1000, 1500)[0]
    assert near[2] > near[0]
    assert far[0] > far[2]
    assert not unknown.any()
    np.testing.assert_array_equal(near, nearer)
    np.testing.assert_array_equal(far, farther)


def test_limits_include_nearly_all_points() -> None:
    clouds = [make_cloud(seed).xyz[..., 2] for seed in range(3)]
    near, far = depth_limits(clouds)
    every = np.concatenate([depth[np.isfinite(depth)] for depth in clouds])
    assert ((every > near) & (every < far)).mean() > 0.95
    with pytest.raises(DaemonError, match="the clouds contain no points"):
        depth_limits([np.full((3, 3), np.nan, np.float32)])


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_a_video_is_readable_with_every_image(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"depth{suffix}"
    depths = [np.full((103, 129), 1000 + 100 * i, np.float32) for i in range(5)]
    assert write_video(path, (depth_image(d, 1000, 1500) for d in depths), rate_hz=10) == 5
    video = cv2.VideoCapture(str(path))
    images = []
    while (answer := video.read())[0]:
        images.append(answer[1])
    video.release()
    assert [image.shape for image in images] == 5 * [(102, 128, 3)]
    for image, depth in zip(images, depths, strict=True):
        expected = depth_image(depth, 1000, 1500)[0, 0].astype(float)
        assert np.abs(image.mean(axis=(0, 1)) - expected).max() < 12
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_failed_video_leaves_no_file(tmp_path: Path) -> None:
    sizes = [(40, 40, 3), (40, 60, 3)]
    with pytest.raises(DaemonError, match="image 1 is 60 x 40"):
        write_video(tmp_path / "x.mp4", (np.zeros(size, np.uint8) for size in sizes), rate_hz=5)
    with pytest.raises(DaemonError, match="no images"):
        write_video(tmp_path / "x.mp4", iter(()), rate_hz=5)
    with pytest.raises(DaemonError, match=r"expected \.mp4 or \.avi"):
        write_video(tmp_path / "x.gif", iter(()), rate_hz=5)
    assert list(tmp_path.iterdir()) == []
