"""What the whole loop needs: an X server, a C compiler and the GenICam packages; in CI nothing of it may be missing."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from sim.box.box import GENTL_DIR, Box
from sim.box.options import from_mapping
from sim.box.xserver import Head, XServer, XServerError

HEADS = Head(320, 240), Head(160, 128)
"""A desktop at the left, a small projector at the right."""


def _missing() -> str:
    programs = {"Xorg": "x11", "cc": "compiler"}
    for program, packages in programs.items():
        if shutil.which(program) is None:
            return f"{program} is missing; install it with: tools/system-packages {packages}"
    return "" if importlib.util.find_spec("harvesters") else "the package harvesters is missing"


@contextmanager
def boxes() -> Iterator[Callable[..., Box]]:
    """As the fixture ``make_box``, for fixtures of another scope."""
    reason = _missing()
    if reason and os.environ.get("CI") == "true":
        pytest.fail(reason)
    if reason:
        pytest.skip(reason)
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:

        def make(box: dict[str, Any] | None = None, *, real_time: bool = False, **simulation: Any) -> Box:
            simulation = {"scene": "mixed", "frames": 1, "layout": {"scale": 0.25}} | simulation
            options = {"tcp": 0, "exposure_us": 500, "readout_us": 500, "simulation": simulation}
            made = stack.enter_context(Box(from_mapping(options | (box or {})), real_time=real_time))
            patch.setenv(GENTL_DIR, str(made.gentl_dir))
            return made

        yield make


@pytest.fixture
def make_box() -> Iterator[Callable[..., Box]]:
    """``make_box(scene="mixed")`` is a small rig in lock-step; options: the simulation's, or ``box={...}``."""
    with boxes() as make:
        yield make


@pytest.fixture
def server() -> Iterator[XServer]:
    """An X server without hardware."""
    made = XServer(HEADS)
    try:
        made.start()
    except XServerError as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(str(error))
    yield made
    made.stop()
