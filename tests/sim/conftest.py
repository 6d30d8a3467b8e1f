"""A small copy of the standard rig: the same field and fringes, an eighth of the pixels along each axis."""

from __future__ import annotations

import pytest

from sim.rig.layout import RigLayout


@pytest.fixture(scope="session")
def small() -> RigLayout:
    return RigLayout().scaled(0.125)
