"""Small copies of the standard rig: the same field and fringes, fewer pixels."""

from __future__ import annotations

import pytest

from sim.rig.layout import RigLayout


@pytest.fixture(scope="session")
def small() -> RigLayout:
    """An eighth of the pixels along each axis."""
    return RigLayout().scaled(0.125)


@pytest.fixture(scope="session")
def quarter() -> RigLayout:
    """A quarter of the pixels along each axis."""
    return RigLayout().scaled(0.25)
