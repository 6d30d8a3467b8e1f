"""Clients of a daemon under load: readers of clouds, pollers of the status, slow, stopped and silent ones.

``python -m benchmarks.load.clients KIND ENDPOINT [shared]``: one of them, at idle priority, until it is killed. Readers
of whole clouds can read them from shared memory.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

import zmq

from fringed import wire
from fringed.errors import OverwrittenError
from fringed.parts import shared_topic
from fringed.shared_memory import SharedMemory
from fringed.stream.receiver import Receiver

_POLL_S, _SLOW_S = 1.0, 0.5


def full(endpoint: str, shared: bool = False) -> None:
    """Read whole clouds."""
    _read(endpoint, "cloud/full", shared=shared)


def light(endpoint: str) -> None:
    """Read the light clouds."""
    _read(endpoint, "cloud/depth")


def slow(endpoint: str, shared: bool = False) -> None:
    """Read two whole clouds a second."""
    _read(endpoint, "cloud/full", shared=shared, pause_s=_SLOW_S)


def silent(endpoint: str) -> None:
    """Subscribe to whole clouds and never receive one."""
    with _Subscribed(endpoint):
        while True:
            time.sleep(3600)


def poller(endpoint: str) -> None:
    """Request the status once a second."""
    from fringed.control.client import ControlClient
    from fringed.errors import ControlError

    with ControlClient(endpoint, timeout_s=30.0) as client:
        _report_connected()
        while True:
            with suppress(ControlError):
                client.call("status")
            time.sleep(_POLL_S)


KINDS: dict[str, Callable[..., None]] = {
    "full": full, "light": light, "slow": slow, "silent": silent, "stopped": full, "poller": poller,
}  # fmt: skip
_SHARING = ("full", "slow", "stopped")


class LoadClients:
    """Many of them, each a process; for ``with``.

    Args:
        stream, control: endpoints of the daemon. counts: how many of each kind.
        shared: whole clouds are read from shared memory.
    """

    def __init__(self, stream: str, control: str, counts: dict[str, int], *, shared: bool = False) -> None:
        self._processes: list[tuple[str, subprocess.Popen[bytes]]] = []
        self._stream, self._control, self._counts, self._shared = stream, control, counts, shared

    def __enter__(self) -> Self:
        for kind, count in self._counts.items():
            endpoint = self._control if kind == "poller" else self._stream
            for _ in range(count):
                command = [sys.executable, "-m", "benchmarks.load.clients", kind, endpoint]
                command += ["shared"] if self._shared and kind in _SHARING else []
                self._processes.append((kind, subprocess.Popen(command, stdout=subprocess.PIPE)))
        for kind, process in self._processes:
            assert process.stdout is not None
            process.stdout.readline()  # it has connected
            if kind == "stopped":
                process.send_signal(signal.SIGSTOP)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _, process in self._processes:
            process.kill()
        for _, process in self._processes:
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


class _Subscribed:
    """A subscriber of whole clouds that has its first connection and never reads."""

    def __init__(self, endpoint: str) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, 2)
        self._socket.subscribe("cloud/full")
        self._socket.connect(endpoint)

    def __enter__(self) -> None:
        self._socket.poll(60_000)
        _report_connected()

    def __exit__(self, *_: object) -> None:
        self._context.destroy(linger=0)


def _read(endpoint: str, topic: str, *, shared: bool = False, pause_s: float = 0.0) -> None:
    memory = SharedMemory()
    receiver, reported = Receiver(endpoint, [shared_topic(topic) if shared else topic], queue=2), False
    while True:
        if receiver.poll(1.0) and (frames := receiver.take()) is not None:
            if not reported:
                _report_connected()
                reported = True
            if shared:
                with suppress(OverwrittenError):
                    wire.decode(frames, memory=memory)
            else:
                for frame in frames:
                    memoryview(frame)[::4096].tobytes()  # touched, as a reader that uses it would
            time.sleep(pause_s)


def _report_connected() -> None:
    sys.stdout.write("connected\n")
    sys.stdout.flush()


if __name__ == "__main__":
    os.nice(19)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    kind, endpoint, *shared = sys.argv[1:]
    KINDS[kind](endpoint, **({"shared": True} if shared else {}))
