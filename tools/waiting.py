"""Waits for conditions, for tests, tools and benchmarks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_until(condition: Callable[[], T], timeout_s: float = 60.0, what: str = "", *, poll_s: float = 0.005) -> T:
    """Return the condition's first true value.

    Args:
        condition: called again and again, ``poll_s`` apart.
        timeout_s: on a loaded machine too, the condition must hold by then.
        what: a name for the message; by default the place of the condition's source.

    Raises:
        TimeoutError: the condition did not hold in time.
    """
    end = time.monotonic() + timeout_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"{what or _source(condition)} did not come true within {timeout_s:g} s")
        time.sleep(poll_s)
    return value


def _source(condition: Callable[[], object]) -> str:
    code = getattr(condition, "__code__", None)
    return f"the condition at {code.co_filename}:{code.co_firstlineno}" if code else str(condition)
