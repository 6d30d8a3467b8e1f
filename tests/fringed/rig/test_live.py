"""``fringed.Rig`` against a daemon on the simulated rig."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import fringed
from fringed import ArgumentError, FringedError, KeyFileError, NoDaemonError, RefusedError, Rig, SilenceError
from fringed.keys import new_key
from tests.daemon.remote_access.world import World, world
from tests.daemon.whole_daemon import measuring

JPEG = b"\xff\xd8\xff"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with measuring(tmp_path_factory.mktemp("rig")) as control:
        yield control


@pytest.fixture
def rig(address: str) -> Iterator[Rig]:
    with Rig(address, timeout_s=60) as made:
        yield made


def test_clouds_come_newest_first_or_all(rig: Rig) -> None:
    with rig.clouds(latest=False, timeout_s=60) as clouds:
        numbers = [next(clouds).header.seq for _ in range(3)]
    assert numbers == sorted(set(numbers)) and clouds.received == 3
    with rig.clouds(topic="cloud/depth", timeout_s=60) as clouds:
        cloud = next(clouds)
    assert cloud.gray is None and cloud.points.shape[1] == 3 and len(cloud.points) > 500
    assert cloud.header.device == "rig-t" and cloud.header.calibration == rig.status().calibration


def test_parts_are_named_by_the_subscriber(rig: Rig) -> None:
    with rig.clouds(parts=("xyz", "rgb", "normals"), timeout_s=60) as clouds:
        cloud = next(clouds)
    assert cloud.gray is None and cloud.rgb is not None and cloud.normals is not None
    lengths = np.linalg.norm(cloud.normals[np.isfinite(cloud.normals[..., 0])], axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)
    with pytest.raises(ArgumentError, match="no part 'color'"):
        rig.clouds(parts=("xyz", "color"))


def test_clouds_on_this_machine_come_from_shared_memory_and_compressed_ones_through_the_socket(rig: Rig) -> None:
    assert rig.hello().shared and rig.stream.startswith("ipc://")
    with rig.clouds(timeout_s=60) as local:
        assert {part.codec for part in next(local).header.parts} == {"shared"}
    with rig.clouds(topic="cloud/depth", timeout_s=60) as light:
        assert {part.codec for part in next(light).header.parts} == {"blosc2"}


def test_clouds_and_previews_come_in_an_event_loop(rig: Rig) -> None:
    async def receive() -> tuple[list[int], bytes]:
        async with rig.clouds(latest=False, timeout_s=60) as clouds:
            numbers = [(await anext(clouds)).header.seq for _ in range(2)]
        previews = rig.previews(timeout_s=60)
        async for preview in previews:
            previews.close()
            return numbers, preview.left
        raise AssertionError

    numbers, left = asyncio.run(receive())
    assert numbers[0] < numbers[1] and left.startswith(JPEG)


def test_previews_are_three_images(rig: Rig) -> None:
    with rig.previews(timeout_s=60) as previews:
        preview = next(previews)
    assert all(image.startswith(JPEG) for image in (preview.left, preview.right, preview.overlay))


def test_status_and_health_are_typed(rig: Rig) -> None:
    status, health, hello = rig.status(), rig.health(), rig.hello()
    assert status.state == "running" and status.cameras["left"].size == (64, 51)
    assert status.recorder.recording is False and status.recorder.file is None
    assert health.device == hello.device == status.device == "rig-t"
    assert {rule.name for rule in health.rules} >= {"least_coverage"}
    history = rig.health_history(["cloud_rate_hz"], seconds=60, points=4)
    assert len(history.series["cloud_rate_hz"].mean) == len(history.t_s)
    assert isinstance(rig.health_events(5), list)


def test_a_setting_is_read_changed_and_restored(rig: Rig) -> None:
    (setting,) = rig.settings("pairing.tolerance_us")
    assert (setting.unit, setting.max, setting.live, setting.value) == ("µs", 1e6, True, 2000.0)
    assert rig.set("pairing.tolerance_us", 1800) == 1800.0 == rig.get("pairing.tolerance_us")
    assert rig.get("pairing")["tolerance_us"] == 1800.0
    assert rig.reload().changed == ["pairing.tolerance_us"]
    assert len(rig.settings()) > 50


def test_a_refusal_has_code_and_path(rig: Rig) -> None:
    with pytest.raises(RefusedError, match="consistency_threshold") as raised:
        rig.set("pipeline.settings.consistency_threshold", "high")
    assert (raised.value.code, raised.value.path) == (-32602, "pipeline.settings.consistency_threshold")
    with pytest.raises(RefusedError, match=r"no method 'no\.such'") as raised:
        rig.call("no.such")
    assert raised.value.code == -32601 and raised.value.path is None


def test_a_snapshot_and_a_take_are_written(rig: Rig) -> None:
    snapshot = rig.snapshot("one")
    with np.load(snapshot.file) as archive:
        assert np.isfinite(archive["xyz"][..., 2]).sum() == snapshot.points
    with rig.record("small", before_s=1.0) as take:
        assert rig.status().recorder.file == take.file
    summary = take.stop()
    assert summary.pairs and summary.recording is False and Path(take.file).exists()
    (entry,) = (entry for entry in rig.takes().takes if take.file.endswith(f"{entry.name}.mcap"))
    # A frame whose partner comes late is written alone.
    assert entry.state == "whole" and sum(entry.frames) == 2 * summary.pairs + summary.lone_frames


def test_pause_mode_and_pattern(rig: Rig) -> None:
    assert rig.stop() == "paused" and rig.start() == "running"
    assert rig.mode().mode == "single" and rig.show() == "fringe"
    with pytest.raises(RefusedError):
        rig.mode("no_such_mode")


def test_an_address_of_a_daemon_opens_too(address: str) -> None:
    with fringed.open(address, timeout_s=60) as rig:
        assert isinstance(rig, Rig) and rig.address == address


def test_the_calling_program_s_mistakes_are_errors_at_once(address: str, tmp_path: Path) -> None:
    (tmp_path / "a.key").write_text("nonsense")
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = f"tcp://127.0.0.1:{server.getsockname()[1]}"
    mistakes: list[tuple[Callable[[], object], type[Exception], str]] = [
        (lambda: Rig("tcp://no-such-host.invalid:5558"), ArgumentError, "'no-such-host.invalid' is unknown"),
        (lambda: Rig("127.0.0.1:99999"), ArgumentError, "port 99999"),
        (lambda: Rig("http://127.0.0.1:80"), ArgumentError, "tcp://HOST:PORT or ipc://PATH"),
        (lambda: Rig(5558), ArgumentError, "address is of type int"),  # type: ignore[arg-type]
        (lambda: Rig(free), NoDaemonError, "nothing listens there"),
        (lambda: Rig(address + "x"), NoDaemonError, "there is no such socket"),
        (lambda: Rig(address, stream=free), NoDaemonError, "nothing listens there"),
        (lambda: Rig(address, stream=address), NoDaemonError, "cannot be reached"),
        (lambda: Rig(address, timeout_s=0), ArgumentError, "timeout_s is 0"),
        (lambda: Rig(address, timeout_s="5"), ArgumentError, "timeout_s is '5'"),  # type: ignore[arg-type]
        (lambda: Rig(address, key=7), ArgumentError, "key is of type int"),  # type: ignore[arg-type]
        (lambda: Rig(address, key="a.key"), ArgumentError, "server_key is None"),
        (lambda: Rig(address, server_key="server.pub"), ArgumentError, "without key"),
        (lambda: Rig(address, key=tmp_path / "a.key", server_key=tmp_path / "b"), KeyFileError, "a.key:1"),
        (lambda: fringed.subscribe(keys="a.key"), ArgumentError, "expected Keys"),  # type: ignore[arg-type]
        (lambda: fringed.subscribe("tcp://no-such-host.invalid:1"), ArgumentError, "is unknown"),
        (lambda: fringed.subscribe("tcp://127.0.0.1"), ArgumentError, "port is missing"),
        (lambda: fringed.subscribe(timeout_s=float("nan")), ArgumentError, "timeout_s is NaN"),
    ]
    for mistake, kind, message in mistakes:
        start_s = time.monotonic()
        with pytest.raises(kind, match=message) as raised:
            mistake()
        assert isinstance(raised.value, FringedError) and time.monotonic() - start_s < 1.5


def test_silence_names_a_port_where_nothing_listens() -> None:
    with (
        fringed.subscribe("tcp://127.0.0.1:1", timeout_s=0.1) as clouds,
        pytest.raises(SilenceError, match="nothing listens there"),
    ):
        next(clouds)


def test_a_wait_without_a_time_out_is_logged(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fringed.stream.cloud_stream._WARN_S", 0.0)

    async def wait() -> None:
        async with fringed.asubscribe("tcp://127.0.0.1:1") as clouds:
            await asyncio.wait_for(anext(clouds), 0.1)

    with pytest.raises(TimeoutError):
        asyncio.run(wait())
    assert "nothing listens there; waiting for a daemon" in caplog.text


@pytest.fixture(scope="module")
def gated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    with world(tmp_path_factory.mktemp("gate")) as made:
        yield made


def test_a_key_opens_a_rig_on_another_machine(gated: World) -> None:
    with Rig(gated.control_at, stream=gated.stream, key=gated.keys(gated.operator), timeout_s=60) as rig:
        assert rig.call("set", value=1) == "done"
        with rig.clouds(timeout_s=60) as clouds:
            assert len(next(clouds).points)


def test_a_refused_key_and_a_wrong_server_key_are_errors_at_once(gated: World) -> None:
    stranger, other = gated.keys(gated.stranger), gated.keys(gated.operator, new_key("other"))
    for key, message in (
        (stranger, "does not accept this key"),
        (other, "server key is another one"),
        (None, "needs keys"),
    ):
        start_s = time.monotonic()
        with pytest.raises(NoDaemonError, match=message):
            Rig(gated.control_at, key=key)
        assert time.monotonic() - start_s < 4.0
    with pytest.raises(NoDaemonError, match="does not accept this key"):
        Rig(gated.control_at, stream=gated.stream, key=stranger)
