"""A browser for the tests that need one."""

from __future__ import annotations

import os

import pytest

from daemon.apps.viewer.screenshot import BROWSERS, browser_program


@pytest.fixture
def browser() -> str:
    """The Chromium on the path; without one the test is skipped, in CI (environment variable CI) it fails."""
    program = browser_program()
    if program is not None:
        return program
    reason = f"no browser on the path ({', '.join(BROWSERS)}); install chromium"
    if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the user's directories unchanged."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
