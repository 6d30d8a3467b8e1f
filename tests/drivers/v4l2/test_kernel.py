"""The driver against a real kernel: the tests in ``guest/`` run inside a virtual machine, all in one start of it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.drivers.v4l2 import machine

pytestmark = pytest.mark.timeout(1300)


@pytest.fixture(scope="module")
def guest(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], str]:
    """Results of the guest's tests, and the console output."""
    reason = machine.missing()
    if reason and os.environ.get("CI", "").lower() in ("1", "true", "yes"):
        pytest.fail(reason)
    elif reason:
        pytest.skip(reason)
    return machine.run(tmp_path_factory.mktemp("vm"))


@pytest.mark.long
@pytest.mark.parametrize("name", machine.guest_tests())
def test_in_the_guest(guest: tuple[dict[str, str], str], name: str) -> None:
    results, console = guest
    assert name in results, f"it did not run; console output:\n{console[-3000:]}"
    if results[name]:
        pytest.fail(f"in the guest:\n{results[name]}\nconsole output:\n{console[-1500:]}", pytrace=False)


@pytest.mark.long
def test_the_guest_reached_its_end(guest: tuple[dict[str, str], str]) -> None:
    results, console = guest
    assert "end" in results, console[-3000:]


def test_all_code_that_the_guest_imports_is_sent_to_it(tmp_path: Path) -> None:
    for name in machine.CODE:
        source, copy = machine.ROOT / name, tmp_path / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
    names = [f"tests.drivers.v4l2.guest.{path.stem}" for path in machine.GUEST.glob("*.py")]
    program = f"import sys; sys.path.remove({str(machine.ROOT)!r}); import {', '.join(names)}"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
