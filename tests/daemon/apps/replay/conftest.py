"""A small take of the simulated rig, and its images."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.daemon.recording import small_take


@pytest.fixture(scope="module")
def images() -> list[small_take.Images]:
    return small_take.render()


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory, images: list[small_take.Images]) -> Path:
    return small_take.write(tmp_path_factory.mktemp("takes") / "take.mcap", images)
