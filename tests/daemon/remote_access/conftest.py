"""A gate shared by all tests that leave it intact."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.remote_access.world import World, world


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """A gate for all tests of a module, which leave it as it was."""
    with world(tmp_path_factory.mktemp("gate")) as made:
        yield made


@pytest.fixture
def own(tmp_path: Path) -> Iterator[World]:
    """A gate for a single test."""
    with world(tmp_path) as made:
        yield made
