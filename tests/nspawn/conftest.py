"""The containers: skipped with the reason where none can be started, which in CI is a failure."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.nspawn.helpers import Fringed, rig
from tools.nspawn import Machine, missing


@pytest.fixture(scope="session")
def container() -> type[Machine]:
    reason = missing()
    if reason and os.environ.get("CI", "").lower() in ("1", "true", "yes"):
        pytest.fail(reason)
    if reason:
        pytest.skip(reason)
    return Machine


@pytest.fixture(scope="session")
def installed(container: type[Machine]) -> Iterator[Fringed]:
    """A machine with the installed service; every module starts it with the rig that it needs."""
    with container() as machine:
        (machine.root / "root/rig.yaml").write_text(rig())
        # Kernels compiled beside the sources are copied too, so this takes seconds.
        machine.fringed("install", "--share-packages", "--rig", "/root/rig.yaml", timeout_s=500)
        made = Fringed(machine)
        made.wait_active()
        yield made
