"""Rendered images of the small rig, once for all tests of the folder."""

from __future__ import annotations

import pytest

from tests.daemon.recording import small_take


@pytest.fixture(scope="session")
def images() -> list[small_take.Images]:
    return small_take.render()
