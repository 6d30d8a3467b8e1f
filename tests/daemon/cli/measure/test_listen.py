"""``fringed listen`` and the examples, with a publisher that sends until they end."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from daemon.live.publishing.publisher import Publisher
from fringed.files.ply import ply_bytes
from tests.daemon.live.publishing import clouds
from tests.fringed.test_wire import GOLDEN

EXAMPLES = Path(__file__).parents[4] / "examples"


@contextmanager
def sending() -> Iterator[Publisher]:
    """A publisher that sends numbered clouds until the block ends."""
    finished = threading.Event()
    with clouds.publisher() as publisher:

        def send() -> None:
            seq = 0
            while not finished.wait(0.005):
                if publisher.has_subscribers("cloud/full"):
                    publisher.offer(clouds.item(seq))
                    seq += 1

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield publisher
        finally:
            finished.set()
            thread.join()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=30, check=False)


def listen(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    from daemon.cli.entry import run as command

    status = command(["listen", *arguments])
    return status, capsys.readouterr().out


def test_listen_reports_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    with sending() as publisher:
        status, out = listen(capsys, publisher.endpoints[0], "--json", "--count", "5")
    reports = [json.loads(line) for line in out.splitlines()]
    assert status == 0 and reports[-1]["clouds"] == 5
    assert reports[-1]["points"] == clouds.item(0).cloud.points and reports[-1]["daemon_latency_ms"] == 21.0


def test_listen_prints_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with sending() as publisher:
        status, out = listen(capsys, publisher.endpoints[0], "--seconds", "0.5")
    assert status == 0 and "rig-t:" in out and "clouds/s" in out and "lost" in out


def test_listen_saves_the_valid_points(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with sending() as publisher:
        status, _ = listen(capsys, publisher.endpoints[0], "--save", str(tmp_path / "out"), "--count", "2")
    files = sorted((tmp_path / "out").iterdir())
    assert status == 0 and len(files) == 2 and all(path.suffix == ".ply" for path in files)
    head, _, body = files[0].read_bytes().partition(b"end_header\n")
    assert f"element vertex {clouds.item(0).cloud.points}".encode() in head
    rows = np.frombuffer(body, [("xyz", "<f4", 3), ("rgb", "|u1", 3)])
    cloud = clouds.item(int(files[0].stem.removeprefix("cloud_"))).cloud
    valid = np.isfinite(cloud.xyz[..., 2])
    np.testing.assert_array_equal(rows["xyz"], cloud.xyz[valid])
    np.testing.assert_array_equal(rows["rgb"][:, 1], cloud.gray[valid])


def test_listen_without_a_daemon_reports_no_cloud(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, out = listen(capsys, f"ipc://{tmp_path}/none", "--seconds", "0.3", "--count", "1")
    assert status == 1 and "no cloud" in out


def test_ply_without_texture() -> None:
    assert b"red" not in ply_bytes(np.zeros((1, 2, 3), np.float32))


def test_the_plain_reader_reads_the_golden_message() -> None:
    result = run(str(EXAMPLES / "02_plain_reader.py"), str(GOLDEN))
    assert result.stderr == ""
    z = clouds.item(17, size=(16, 12)).cloud.xyz[..., 2]
    assert result.stdout == (
        f"cloud/full 17 {np.isfinite(z).sum()} points, mean z {np.nanmean(z):.3f} mm xyz gray sigma\n"
    )


def test_the_plain_reader_is_short_and_independent() -> None:
    text = (EXAMPLES / "02_plain_reader.py").read_text()
    assert len(text.splitlines()) <= 40
    assert "fringed" not in text and "daemon" not in text


def test_the_plain_reader_reads_a_live_stream() -> None:
    with sending() as publisher:
        result = run("-W", "error", str(EXAMPLES / "02_plain_reader.py"), publisher.endpoints[0], "3")
    assert (result.returncode, result.stderr) == (0, "")
    assert len(result.stdout.splitlines()) == 3


def test_importing_the_client_imports_nothing_of_the_rig() -> None:
    code = (
        "import sys, fringed; light = set(sys.modules); fringed.subscribe\n"
        "assert not {'zmq', 'numpy', 'msgspec'} & light, light\n"
        "heavy = {'blosc2', 'cv2', 'numba', 'daemon', 'pipeline', 'drivers', 'sim'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    assert run("-c", code).stderr == ""
