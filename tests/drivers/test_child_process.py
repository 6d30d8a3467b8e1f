"""Child processes import the packages of the process that starts them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    "call",
    ["from drivers.projector.x11.listing import outputs; outputs(':77')",
     "from drivers.genicam.listing import discover; discover([])"],
    ids=["projector", "cameras"],
)  # fmt: skip
def test_a_folder_named_like_a_package_in_the_working_directory_replaces_nothing(call: str, tmp_path: Path) -> None:
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers" / "__init__.py").write_text("raise SystemExit('another package')")
    done = subprocess.run(
        [sys.executable, "-P", "-c", call], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert "another package" not in done.stderr, done.stderr


def test_where_the_caller_imports_from_its_directory_a_child_does_too(tmp_path: Path) -> None:
    call = "from drivers.child_process import interpreter; print(interpreter()[1:])"
    flags = [
        subprocess.run([sys.executable, *flag, "-c", call], cwd=tmp_path, capture_output=True, text=True, check=True)
        for flag in ([], ["-P"])
    ]
    assert [done.stdout for done in flags] == ["[]\n", "['-P']\n"]
