"""An X server without hardware: a desktop at the left, a small projector at the right."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from sim.box.xserver import Head, XServer, XServerError

HEADS = Head(320, 240), Head(160, 128)


@pytest.fixture
def server() -> Iterator[XServer]:
    made = XServer(HEADS)
    try:
        made.start()
    except XServerError as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(str(error))
    yield made
    made.stop()
