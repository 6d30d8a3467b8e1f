"""``fringed view`` shows the newest messages, and a viewer that hangs disturbs no other process."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import cv2
import pytest

from daemon.apps.viewer import rerun_targets, screenshot
from daemon.apps.viewer.bridge import Bridge, Options
from daemon.apps.viewer.stream_source import NewestMessages
from daemon.cli.entry import run
from fringed import SilenceError, subscribe
from tests.daemon.apps.viewer import rrd_contents
from tests.daemon.live.publishing import clouds
from tests.daemon.remote_access import listening_addresses
from tools.waiting import wait_until

LARGE = (256, 205)


@contextmanager
def viewing(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """``fringed view`` as a process."""
    program = "from daemon.cli.entry import main; main()"
    command = [sys.executable, "-c", program, "view", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for_subscribers(publisher: Any, *topics: str) -> None:
    wait_until(lambda: all(publisher.has_subscribers(topic) for topic in topics))


def test_only_the_newest_pending_message_of_each_topic_is_kept() -> None:
    with clouds.publisher() as publisher, NewestMessages(publisher.endpoints[0]) as source:
        wait_for_subscribers(publisher, "cloud/full", "preview")
        for seq in range(5):
            clouds.send(publisher, clouds.item(seq))

            def arrived(seq: int = seq) -> bool:
                source.drain(0.01)
                return source.skipped == seq and "cloud/full" in source._pending

            wait_until(arrived)
        (cloud,) = (message for message in source.newest() if message.topic == "cloud/full")
        assert cloud.header.seq == 4 and (source.skipped, source.lost) == (4, 0)
        assert not list(source.newest())


def test_clouds_images_and_figures_of_a_stream_reach_the_file(tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    with clouds.publisher() as publisher, NewestMessages(publisher.endpoints[0]) as source:
        wait_for_subscribers(publisher, "cloud/full", "preview", "status")
        with rerun_targets.file_recording(file) as recording:
            bridge = Bridge(source, recording, Options(decimate=1, rate_hz=1000))
            clouds.send(publisher, clouds.item(3))
            publisher.publish_status({"t_ns": 5, "cloud_rate_hz": 4.5, "drops": {"a": 2, "b": 3}})
            received: set[str] = set()

            def all_arrived() -> bool:
                source.drain(0.01)
                received.update(source._pending)
                bridge.show_newest()
                return received == {"cloud/full", "preview", "status"}

            wait_until(all_arrived)
    assert list(rrd_contents.clouds(file)) == [3]
    assert {"/images/left", "/images/right", "/images/modulation"} <= rrd_contents.entities(file)
    figures = {
        name: [float(value[0]) for value in rrd_contents.rows(file, f"/figures/{name}", "Scalars:scalars").values()]
        for name in ("rate_hz", "drops", "points", "latency_ms")
    }
    assert figures == {"rate_hz": [4.5], "drops": [5.0], "points": [32 * 26 - 12], "latency_ms": [21.0]}


def test_a_viewer_that_hangs_delays_neither_the_publisher_nor_other_subscribers(tmp_path: Path) -> None:
    file, large = tmp_path / "x.rrd", clouds.item(0, size=LARGE)
    numbers = iter(range(1, 1_000_000))
    with clouds.publisher() as publisher:
        arguments = ("--save", str(file), "--rate", "60", "--count", "30")
        with viewing(publisher.endpoints[0], *arguments) as viewer:
            wait_for_subscribers(publisher, "cloud/full")
            os.kill(viewer.pid, signal.SIGSTOP)
            for seq in islice(numbers, 80):  # 70 MB, far more than the capacity of sockets and queues
                clouds.send(publisher, replace(large, seq=seq))
            with subscribe(publisher.endpoints[0], timeout_s=0.01) as healthy:

                def served() -> bool:
                    clouds.send(publisher, replace(large, seq=next(numbers)))
                    with suppress(SilenceError):
                        next(healthy)
                    return healthy.received >= 10

                wait_until(served)
            newest = next(numbers)
            os.kill(viewer.pid, signal.SIGCONT)

            def ended() -> bool:
                publisher.offer(replace(large, seq=next(numbers)))
                return viewer.poll() is not None

            wait_until(ended, 20.0)
            _, output = viewer.communicate()
            assert viewer.returncode == 0, output
    assert max(rrd_contents.clouds(file)) > newest and "30 clouds" in output


def test_ctrl_c_finishes_the_file(tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    with clouds.publisher() as publisher, viewing(publisher.endpoints[0], "--save", str(file)) as viewer:
        wait_for_subscribers(publisher, "cloud/full")
        partial, large = file.with_name(".x.rrd.partial"), clouds.item(1, size=LARGE)

        def written() -> bool:
            publisher.offer(large)
            return partial.exists() and partial.stat().st_size > large.cloud.xyz.nbytes // 8

        wait_until(written)
        viewer.send_signal(signal.SIGINT)
        _, output = viewer.communicate(timeout=60)
    assert viewer.returncode == 0, output
    assert list(rrd_contents.clouds(file)) == [1] and not partial.exists()


def test_no_cloud_is_an_error_that_names_the_endpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"ipc://{tmp_path}/nobody"
    assert run(["view", endpoint, "--save", str(tmp_path / "x.rrd"), "--seconds", "0.2"]) == 2
    assert f"no cloud arrived from {endpoint}" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--color", "pink"], ["--web", "--save", "x.rrd"], ["--decimate", "0"]])
def test_usage_errors_are_reported(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["view", *arguments]) == 2
    assert capsys.readouterr().err


def test_the_web_viewer_prints_one_line_with_its_address_and_serves_the_page() -> None:
    with clouds.publisher() as publisher:
        arguments = ("--web", "--web-port", "0", "--grpc-port", "0")
        with viewing(publisher.endpoints[0], *arguments) as viewer:
            assert viewer.stdout is not None
            address = viewer.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:") and "/?url=rerun%2Bhttp://127.0.0.1:" in address
            with urlopen(address.partition("?")[0], timeout=10) as page:
                assert b"<html" in page.read().lower()
            wait_until(lambda: len(listening_addresses.addresses(viewer.pid)) >= 2, 60)
            assert {host for host, _ in listening_addresses.addresses(viewer.pid)} == {"127.0.0.1"}
            viewer.send_signal(signal.SIGINT)
            viewer.communicate(timeout=10)


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.usefixtures("browser")
def test_an_image_of_the_viewer_shows_the_cloud(tmp_path: Path) -> None:
    finished = threading.Event()
    file = tmp_path / "view.png"
    with clouds.publisher() as publisher:

        def send() -> None:
            large, seq = clouds.item(0, size=LARGE), 0
            while not finished.wait(0.2):
                seq += 1
                publisher.offer(replace(large, seq=seq, t_ns=1_700_000_000_000_000_000 + seq * 200_000_000))

        sender = threading.Thread(target=send)
        sender.start()
        try:
            screenshot.save_screenshot(publisher.endpoints[0], file)
        finally:
            finished.set()
            sender.join()
    image = cv2.imread(str(file))
    assert image is not None and image.shape == (900, 1400, 3)
    assert screenshot.paint(file.read_bytes()).enough


@pytest.mark.parametrize(("status", "message"), [(0, "no cloud arrived"), (3, "the viewer ended with exit status 3")])
def test_the_command_ends_with_its_native_viewer(
    status: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "viewer"
    program.write_text(f"#!/bin/sh\nexit {status}\n")
    program.chmod(0o755)
    monkeypatch.setattr(rerun_targets, "viewer_program", lambda: program)
    monkeypatch.setenv("DISPLAY", ":0")
    assert run(["view", f"ipc://{tmp_path}/nobody"]) == (1 if status else 2)
    assert message in capsys.readouterr().err


def test_a_port_in_use_is_reported_and_the_default_one_is_replaced_by_a_free_one() -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        with pytest.raises(rerun_targets.DaemonError, match=f"port {port} is in use"):
            rerun_targets._port(port, 1, "127.0.0.1")
        assert rerun_targets._port(None, port, "127.0.0.1") not in (0, port)
