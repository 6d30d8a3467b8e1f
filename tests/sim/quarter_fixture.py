"""A quarter of the standard rig each way: the same field, fewer pixels."""

from __future__ import annotations

import pytest

from sim.rig.layout import RigLayout


@pytest.fixture(scope="session")
def quarter() -> RigLayout:
    return RigLayout().scaled(0.25)
