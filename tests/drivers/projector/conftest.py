"""X servers without hardware, and projectors on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.projector import OutputProjector
from drivers.projector.options import ProjectorOptions, read
from sim.box.xserver import XServer
from tests.drivers.projector import x


@pytest.fixture(scope="session")
def server() -> Iterator[XServer]:
    """One server with a desktop on DUMMY0 and a projector on DUMMY1, for tests that leave it as it was."""
    running = x.start(XServer((x.DESKTOP, x.PROJECTOR)))
    yield running
    running.stop()


@pytest.fixture
def own_server() -> Iterator[XServer]:
    """A server for one test alone, which may break it."""
    running = x.start(XServer((x.DESKTOP, x.PROJECTOR)))
    yield running
    running.stop()


@pytest.fixture
def projector(tmp_path: Path) -> Iterator[Callable[..., OutputProjector]]:
    """``projector(server, output="DUMMY1", ...)``: a closed projector, which is closed again after the test."""
    made: list[OutputProjector] = []

    def make(server: XServer, *, hung_s: float = 20.0, **options: Any) -> OutputProjector:
        values = {"output": "DUMMY1", "display": server.display, "show_timeout_s": 20.0, **options}
        made.append(OutputProjector(read(ProjectorOptions, values), tmp_path, hung_s=hung_s))
        return made[-1]

    yield make
    for each in made:
        each.close()
