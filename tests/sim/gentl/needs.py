"""What these tests need beside the project itself."""

from __future__ import annotations

import os
from typing import NoReturn

import pytest


def missing(reason: str) -> NoReturn:
    """Skip what needs it, with the reason; in CI (environment variable CI) nothing is left out and it fails."""
    if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
        pytest.fail(reason)
    pytest.skip(reason, allow_module_level=True)
