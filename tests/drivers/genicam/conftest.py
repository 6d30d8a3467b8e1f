"""Fixtures: producers, emulated cameras, and cameras that are closed in the end."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.genicam import open_camera
from drivers.protocols import Camera, Side
from sim.gentl.cable import Cable
from tests.drivers.genicam import producers


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The directory in which emulated cameras and their processes meet; short, for the sockets in it."""
    with tempfile.TemporaryDirectory(prefix="cams-") as directory:
        monkeypatch.setenv("FRINGED_GENTL_DIR", directory)
        yield Path(directory)


@pytest.fixture
def opened() -> Iterator[Callable[..., Camera]]:
    """Makes cameras by ``open_camera`` and closes them in the end."""
    made: list[Camera] = []

    def make(options: dict[str, Any], side: Side = "left") -> Camera:
        made.append(open_camera(side, options, Path("/")))
        return made[-1]

    yield make
    for camera in made:
        camera.close()


@pytest.fixture
def ours() -> Path:
    """Our own producer."""
    return producers.library("ours")


@pytest.fixture
def rig(world: Path) -> Iterator[tuple[Cable, Cable]]:
    """Two emulated cameras."""
    with producers.cables(world) as pair:
        yield pair
