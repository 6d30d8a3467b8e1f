"""Emulated cameras and an X server for the doctor's checks."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.box.xserver import XServer
from sim.gentl.cable import Cable
from tests.drivers.genicam import producers
from tests.drivers.projector import x


@pytest.fixture
def producer() -> Path:
    """The project's own GenTL producer."""
    return producers.library("ours")


@pytest.fixture
def cables(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Cable, Cable]]:
    """Two emulated cameras, A1 and A2."""
    with tempfile.TemporaryDirectory(prefix="cams-") as directory:
        monkeypatch.setenv("FRINGED_GENTL_DIR", directory)
        with producers.cables(Path(directory)) as pair:
            yield pair


@pytest.fixture(scope="session")
def server() -> Iterator[XServer]:
    """A desktop on DUMMY0 and a projector on DUMMY1, 320x256 at 59.94 Hz."""
    running = x.start(XServer((x.DESKTOP, x.PROJECTOR)))
    yield running
    running.stop()
