"""Rewrites the assertions of all tests into cached bytecode once; else each worker process of a fresh clone does it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from _pytest.assertion import rewrite


def rewrite_all(config: pytest.Config, folder: Path) -> None:
    """Do what pytest's import hook does, for each module of tests that has no current bytecode.

    Uses internals of pytest: it is pinned to one version.
    """
    state = config.stash[rewrite.assertstate_key]
    if sys.dont_write_bytecode:
        return
    for path in [*folder.rglob("test_*.py"), *folder.rglob("conftest.py")]:
        cached = rewrite.get_cache_dir(path) / f"{path.stem}{rewrite.PYC_TAIL}"
        if rewrite._read_pyc(path, cached) is None:
            source, code = rewrite._rewrite_test(path, config)
            cached.parent.mkdir(exist_ok=True)
            rewrite._write_pyc(state, code, source, cached)
