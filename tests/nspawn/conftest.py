"""The containers: skipped with their reason where there can be none, which in CI is a failure."""

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
    """A machine where the service was installed, which starts it; every module starts it with the rig that it needs."""
    with container() as machine:
        (machine.root / "root/rig.yaml").write_text(rig())
        # Kernels that are compiled beside the sources are taken along, so this takes seconds.
        machine.fringed("install", "--share-packages", "--rig", "/root/rig.yaml", timeout_s=500)
        made = Fringed(machine)
        made.wait_active()
        yield made
