"""Targets of a recording: a native viewer, a web viewer, a file; each with limited memory."""

from __future__ import annotations

import importlib
import logging
import os
import socket
import subprocess
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from daemon.apps.viewer.rerun_import import rerun
from daemon.common.errors import DaemonError
from drivers import child_process

log = logging.getLogger("fringed.view")

VIEWER_MEMORY = "2GB"
SERVER_MEMORY = "256MiB"
WEB_PORT, GRPC_PORT = 9090, 9876

_HOST = "127.0.0.1"
_FLUSH_S = 5.0
_START_S, _WINDOW_S = 60.0, 0.5


def to_viewer() -> Any:
    """A recording sent to a native viewer, which keeps it after the end of this process.

    Raises:
        DaemonError: the viewer does not start, such as without a display.
    """
    rr = rerun()  # first: it switches the reports off, in the viewer too
    port = _port(0, GRPC_PORT, _HOST)
    viewer = _open_viewer(port, [])
    _await(viewer, port)
    recording = rr.RecordingStream("fringed")
    recording.connect_grpc(f"rerun+http://{_HOST}:{port}/proxy")
    return recording


def to_file(path: Path) -> Any:
    """A recording written to a file as it is logged."""
    recording = rerun().RecordingStream("fringed")
    recording.save(path)
    return recording


@contextmanager
def file_recording(path: Path) -> Iterator[Any]:
    """A recording that becomes the file ``path`` when the block ends without an error."""
    temporary = path.with_name(f".{path.name}.partial")
    path.parent.mkdir(parents=True, exist_ok=True)
    recording = to_file(temporary)
    try:
        yield recording
        recording.flush()
        recording.disconnect()
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    finally:
        recording.disconnect()
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def web_recording(*, web_port: int | None, grpc_port: int | None) -> Iterator[tuple[Any, str]]:
    """A recording served to browsers on this machine only, and its address.

    Args:
        web_port, grpc_port: of the page and of the data; 0 = any free one; None = the default one, or a free one.
    """
    page, data = _port(web_port, WEB_PORT, _HOST), _port(grpc_port, GRPC_PORT, _HOST)
    with _served(data) as recording, _page(page, data):
        yield recording, f"http://{_HOST}:{page}/?url=rerun%2Bhttp://{_HOST}:{data}/proxy"


@contextmanager
def native_recording() -> Iterator[tuple[Any, subprocess.Popen[bytes]]]:
    """A recording shown by a native viewer, and the viewer, which stays open after the block.

    The viewer fetches the data from this process, so a closed viewer is detected and delays nothing.
    """
    data = _port(0, GRPC_PORT, _HOST)
    with _served(data) as recording:
        address = f"rerun+http://{_HOST}:{data}/proxy"
        yield recording, _open_viewer(_port(0, GRPC_PORT, _HOST), ["--connect", address])


@contextmanager
def _page(page: int, data: int) -> Iterator[None]:
    """The process that serves the viewer's page."""
    process = child_process.start("daemon.apps.viewer.web_page", [str(page), str(data), str(os.getpid())])
    output = child_process.OutputReader(process, log, "page-prints")
    try:
        _await(process, page)
        yield
    finally:
        process.terminate()
        child_process.end(process, _FLUSH_S)
        output.join(1.0)


@contextmanager
def _served(port: int) -> Iterator[Any]:
    rr = rerun()
    # A unique id for each run: open viewers must not mix two runs.
    recording = rr.RecordingStream("fringed", recording_id=uuid.uuid4())
    sink = rr.GrpcServerSink(bind_ip=_HOST, port=port, server_memory_limit=SERVER_MEMORY, newest_first=True)
    recording.set_sinks(sink)
    try:
        yield recording
    finally:
        with suppress(RuntimeError, ValueError):  # a viewer that hangs must not block the end of this process
            recording.flush(timeout_sec=_FLUSH_S)
        recording.disconnect()


def _open_viewer(port: int, arguments: list[str]) -> subprocess.Popen[bytes]:
    """Start the native viewer; its defaults are every network interface and 75 % of the memory."""
    options = ["--bind", _HOST, "--port", str(port), "--memory-limit", VIEWER_MEMORY, "--hide-welcome-screen"]
    environment = {"RUST_LOG": "error"} | os.environ
    return subprocess.Popen([str(viewer_program()), *options, *arguments], stdin=subprocess.DEVNULL, env=environment)


def _await(viewer: subprocess.Popen[bytes], port: int) -> None:
    """Wait until the viewer listens on its port."""
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s:
        check_viewer(viewer)
        with suppress(OSError), socket.create_connection((_HOST, port), timeout=1.0):
            break
        time.sleep(0.05)
    else:
        viewer.terminate()
        raise DaemonError(f"the viewer did not start within {_START_S:.0f} s; use a .rrd file instead")
    with suppress(subprocess.TimeoutExpired):  # it listens before it opens its window, which may fail
        viewer.wait(_WINDOW_S)
    check_viewer(viewer)


def check_viewer(viewer: subprocess.Popen[bytes]) -> None:
    """Raise DaemonError if the viewer ended with an error."""
    if viewer.poll():
        raise DaemonError(
            f"the viewer ended with exit status {viewer.returncode}; it requires a display: without one, "
            "use a .rrd file or, for fringed view, --web"
        )


def viewer_program() -> Path:
    """The viewer's program; the script ``rerun`` on the path would start it as a child."""
    rerun_cli: Any = importlib.import_module("rerun_cli")

    program = Path(str(rerun_cli.__file__)).with_name("rerun")
    if not program.is_file():
        raise DaemonError(f"the native viewer {program} is not installed; use --web or --save FILE.rrd")
    return program


def _port(requested: int | None, default: int, host: str) -> int:
    """A free port; Rerun itself only logs that a port is in use."""
    candidates = [default, 0] if requested is None else [requested]
    for candidate in candidates:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except OSError:
                continue
            port: int = probe.getsockname()[1]
            return port
    raise DaemonError(f"port {requested} is in use or not allowed; choose another one, or 0 for any free one")
