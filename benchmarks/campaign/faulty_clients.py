"""Clients that behave badly: storms, subscribers that stop or never read, and invalid data."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Any

import zmq

from benchmarks.campaign.rig import CampaignRig, pause
from fringed.errors import ControlError

_SUBSCRIBER = """
import sys, time, zmq
socket = zmq.Context().socket(zmq.SUB)
socket.setsockopt(zmq.RCVHWM, 2)
socket.subscribe("cloud/full")
socket.connect(sys.argv[1])
print("connected", flush=True)
while True:
    if sys.argv[2] == "reads":
        socket.recv_multipart()
    else:
        time.sleep(1)
"""


def subscriber_storm(rig: CampaignRig, random_: random.Random) -> None:
    """Sixty subscribers come and go, some in the middle of a message."""
    context: zmq.Context[Any] = zmq.Context()
    endpoint = rig.config["stream"]["endpoints"][0]
    for _ in range(60):
        socket = context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.subscribe(random_.choice(["cloud/full", "cloud/depth", "", "status", "meta/"]))
        socket.connect(endpoint)
        socket.poll(random_.randint(0, 20))
        socket.close()
    context.destroy(linger=0)


def stopped_subscriber(rig: CampaignRig, random_: random.Random) -> None:
    """One that reads whole clouds is stopped for a while, and killed."""
    with _subscriber(rig, "reads") as process:
        pause(0.3)
        process.send_signal(signal.SIGSTOP)
        pause(random_.uniform(0.5, 2.0))
        process.send_signal(signal.SIGCONT)


def silent_subscriber(rig: CampaignRig, random_: random.Random) -> None:
    """One subscribes to whole clouds and never receives one."""
    with _subscriber(rig, "never"):
        pause(random_.uniform(0.5, 2.0))


def invalid_data(rig: CampaignRig, random_: random.Random) -> None:
    """Random bytes to both sockets, as raw connections and as messages."""
    import socket

    for endpoint in (rig.config["control"]["endpoint"], rig.config["stream"]["endpoints"][0]):
        for _ in range(20):
            with socket.socket(socket.AF_UNIX) as raw, suppress(OSError):
                raw.settimeout(1.0)
                raw.connect(endpoint.removeprefix("ipc://"))
                raw.sendall(random_.randbytes(random_.randint(1, 5000)))
    context: zmq.Context[Any] = zmq.Context()
    dealer = context.socket(zmq.DEALER)
    dealer.setsockopt(zmq.LINGER, 0)
    dealer.connect(rig.config["control"]["endpoint"])
    for _ in range(200):
        dealer.send(random_.randbytes(random_.randint(0, 2000)), zmq.NOBLOCK)
    dealer.poll(200)
    context.destroy(linger=0)


def status_storm(rig: CampaignRig, random_: random.Random) -> None:  # noqa: ARG001
    """Eight clients ask for the status as fast as they can for a second."""
    end = time.monotonic() + 1.0

    def ask() -> None:
        while time.monotonic() < end:
            with suppress(ControlError):
                rig.daemon.ask("status", timeout_s=2.0)

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


class _subscriber:  # noqa: N801 - reads as a noun with an article
    """A subscriber in a process of its own, killed at the end."""

    def __init__(self, rig: CampaignRig, how: str) -> None:
        command = [sys.executable, "-c", _SUBSCRIBER, rig.config["stream"]["endpoints"][0], how]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, env=dict(os.environ))

    def __enter__(self) -> subprocess.Popen[bytes]:
        assert self._process.stdout is not None
        self._process.stdout.readline()
        return self._process

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
