"""One gate for all tests that leave it whole."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.remote_access.world import World, world


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """For a module's tests; each must leave it as it was."""
    with world(tmp_path_factory.mktemp("gate")) as made:
        yield made


@pytest.fixture
def own(tmp_path: Path) -> Iterator[World]:
    """For one test alone."""
    with world(tmp_path) as made:
        yield made
