"""The logger writes the measured values, and colours encode the chosen quantity."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from daemon.apps.viewer import colors, rerun_import, rerun_log, rerun_targets, screenshot
from tests.daemon.apps.viewer import rrd_contents
from tests.daemon.live.publishing import clouds


def write(file: Path, cloud: Any, **options: Any) -> None:
    recording = rerun_targets.to_file(file)
    logger = rerun_log.Logger(recording, **options)
    logger.time(seq=7, t_ns=1_700_000_000_123_456_789)
    logger.cloud(cloud.xyz, cloud.gray, cloud.sigma_mm)
    logger.figures({"points": 3.0})
    cloud.xyz[:] = 0  # a reused buffer must not change logged values
    recording.flush()
    recording.disconnect()


@pytest.mark.parametrize("decimate", [1, 2, 3])
def test_the_logged_points_are_the_valid_ones_of_every_nth_row_and_column(tmp_path: Path, decimate: int) -> None:
    cloud = clouds.item(1).cloud
    expected = cloud.xyz[::decimate, ::decimate].reshape(-1, 3).copy()
    write(tmp_path / "x.rrd", cloud, decimate=decimate)
    found = rrd_contents.clouds(tmp_path / "x.rrd")
    assert list(found) == [7]
    np.testing.assert_array_equal(found[7].astype(np.float32), expected[np.isfinite(expected[:, 2])])


def test_times_figures_and_axes_are_in_the_file(tmp_path: Path) -> None:
    write(tmp_path / "x.rrd", clouds.item(1).cloud)
    (time,) = rrd_contents.rows(tmp_path / "x.rrd", "/figures/points", "Scalars:scalars")
    assert time == 1_700_000_000_123_456_789
    assert {"/world", "/world/cloud", "/figures/points"} <= rrd_contents.entities(tmp_path / "x.rrd")


def test_texture_colours_are_the_grey_of_each_logged_point(tmp_path: Path) -> None:
    cloud = clouds.item(1).cloud
    gray = cloud.gray[np.isfinite(cloud.xyz[..., 2])].astype(np.uint32)
    write(tmp_path / "x.rrd", cloud, decimate=1, color="texture")
    (found,) = rrd_contents.rows(tmp_path / "x.rrd", "/world/cloud", "Points3D:colors").values()
    np.testing.assert_array_equal(found.reshape(-1), gray << 24 | gray << 16 | gray << 8 | 255)


@pytest.mark.parametrize("color", ["depth", "sigma"])
def test_scaled_colours_run_from_blue_to_red(color: str) -> None:
    values = np.linspace(0.1, 900, 500, dtype=np.float32)
    packed = colors.packed(color, z=values, gray=values.astype(np.uint8), sigma=values)
    red, blue = packed >> 24, packed >> 8 & 255
    assert np.all(packed & 255 == 255) and blue[50] > red[50] and red[-50] > blue[-50]


def test_bounds_exclude_outliers_and_are_stable_under_small_changes() -> None:
    z = np.random.default_rng(1).normal(1403.0, 2.0, 5000).astype(np.float32)
    low, high = colors.bounds(z, 10.0)
    z[:20] = 9000.0
    assert (low, high) == colors.bounds(z + np.float32(0.1), 10.0) == (1390.0, 1410.0)


def test_a_cloud_without_points_is_logged(tmp_path: Path) -> None:
    cloud = clouds.item(1).cloud
    cloud.xyz[:] = np.nan
    for color in colors.COLORS:
        write(tmp_path / f"{color}.rrd", clouds.item(1).cloud if color == "x" else cloud, color=color)
        cloud.xyz[:] = np.nan


def test_images_are_decoded_and_only_damaged_ones_are_left_out(tmp_path: Path) -> None:
    left = np.full((40, 60, 3), (10, 100, 200), np.uint8)
    jpeg = cv2.imencode(".jpg", left)[1].reshape(-1)
    recording = rerun_targets.to_file(tmp_path / "x.rrd")
    logger = rerun_log.Logger(recording, decimate=1)
    logger.time(seq=1, t_ns=1)
    logger.images({"left": jpeg, "right": jpeg[:9], "overlay": jpeg[:0]})
    recording.flush()
    recording.disconnect()
    assert "/images/right" not in rrd_contents.entities(tmp_path / "x.rrd")
    (buffer,) = rrd_contents.rows(tmp_path / "x.rrd", "/images/left", "Image:buffer").values()
    np.testing.assert_allclose(buffer.reshape(left.shape), left, atol=4)


def test_the_usage_reports_of_rerun_are_off_without_changing_the_users_file() -> None:
    config = Path(os.environ["XDG_CONFIG_HOME"])
    rerun_import.rerun()
    process = subprocess.run(
        [str(rerun_targets.viewer_program()), "analytics", "config"], capture_output=True, text=True, check=True
    )
    assert '"analytics_enabled": false' in process.stdout
    assert not list(config.iterdir())


def test_an_unfinished_file_is_removed(tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    with pytest.raises(RuntimeError, match="stop"), rerun_targets.file_recording(file) as recording:
        rerun_log.Logger(recording)
        raise RuntimeError("stop")
    assert not list(tmp_path.iterdir())


def test_paint_distinguishes_an_empty_view_from_a_cloud() -> None:
    empty = np.full((900, 1400, 3), 24, np.uint8)
    drawn = empty.copy()
    drawn[250:450, 300:600] = np.linspace(0, 255, 300, dtype=np.uint8)[:, None] * np.array([1, 0, 1], np.uint8)
    paints = [screenshot.paint(cv2.imencode(".png", image)[1].tobytes()) for image in (empty, drawn)]
    assert [paint.enough for paint in paints] == [False, True]
    assert not screenshot.paint(b"no png").enough


def test_waiting_for_paint_is_bounded() -> None:
    image = cv2.imencode(".png", np.zeros((90, 140, 3), np.uint8))[1].tobytes()
    with pytest.raises(screenshot.DaemonError, match="showed no cloud within 0 s"):
        screenshot.wait_for_paint(lambda: image, timeout_s=0.05, poll_s=0.01)
