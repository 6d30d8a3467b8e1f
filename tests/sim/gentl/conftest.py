"""The producer, compiled once, and cables in a directory of the test's own."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.gentl.build import NoCompilerError, build
from sim.gentl.cable import Cable
from tests.sim.gentl.needs import missing

WIDTH, HEIGHT = 48, 32


@pytest.fixture(scope="session")
def producer() -> Path:
    """The compiled GenTL producer."""
    try:
        return build()
    except NoCompilerError as error:
        missing(str(error))


@pytest.fixture
def directory(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """What FRINGED_GENTL_DIR names, with a path short enough for a socket; empty again at the end."""
    with tempfile.TemporaryDirectory(prefix="gentl-") as name:
        monkeypatch.setenv("FRINGED_GENTL_DIR", name)
        yield Path(name)
        assert list(Path(name).iterdir()) == [], "closed cables and programs leave nothing behind"


@pytest.fixture
def cable(directory: Path) -> Iterator[Callable[..., Cable]]:
    """``cable()`` is a new camera, without real time unless asked for; closed at the end."""
    with contextlib.ExitStack() as cables:

        def make(**options: Any) -> Cable:
            number = options.pop("number", 0)
            defaults: dict[str, Any] = {"serial": f"CAM{number}", "size": (WIDTH, HEIGHT), "real_time": False}
            return cables.enter_context(Cable(directory, number, **defaults | options))

        yield make


@pytest.fixture
def image() -> NDArray[np.uint8]:
    """A colour image in which every byte may have any value."""
    return np.random.default_rng(7).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
