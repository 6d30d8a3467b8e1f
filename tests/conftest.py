"""What all tests share: the public data sets, where they are there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """``shared_data("bust", "take.mcap")`` is a file of the public data sets.

    They stand beside the repository (or where FRINGED_SHARED_DATA says) and are no part of it: without them the test
    is skipped, in CI (environment variable CI) it fails.
    """
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    root = Path(os.environ.get("FRINGED_SHARED_DATA", beside))

    def find(*names: str) -> Path:
        path = root.joinpath(*names)
        if path.exists():
            return path
        reason = f"the public data set {path} is not there; set FRINGED_SHARED_DATA to its directory"
        if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
            pytest.fail(reason)
        pytest.skip(reason)

    return find
