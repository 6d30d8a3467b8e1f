"""Runs the guest's tests in the virtual machine of ``tools/vm`` and collects their results."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
GUEST = Path(__file__).parent / "guest"
MAIN = (GUEST / "main.py").relative_to(ROOT)
CODE = (
    "daemon/__init__.py", "daemon/live/__init__.py", "daemon/live/items.py", "daemon/live/acquisition/__init__.py",
    "daemon/live/acquisition/trigger_count.py", "daemon/live/acquisition/pairer.py",
    "daemon/live/acquisition/pairing_events.py", "daemon/live/acquisition/waiting_frames.py", "drivers",
    "tests/__init__.py", "tests/drivers/__init__.py", "tests/drivers/v4l2/__init__.py", str(GUEST.relative_to(ROOT)),
    "tools/__init__.py", "tools/waiting.py",
)  # fmt: skip
BUILD = ROOT / "tools" / "vm" / "build"
TOOLS = ("qemu-system-x86_64", "apt-get", "depmod", "mkfs.ext4", "gcc", "make")
BUILD_LIMIT_S, RUN_LIMIT_S = 600, 600


def guest_tests() -> list[str]:
    """``module.test_name`` of every test of the guest, without importing any."""
    found = []
    for path in sorted(GUEST.glob("*.py")):
        functions = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)]
        found += [f"{path.stem}.{node.name}" for node in functions if node.name.startswith("test_")]
    return found


def missing() -> str:
    """What this machine lacks for the virtual one, in a sentence; empty if nothing."""
    places = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))
    lacking = [tool for tool in TOOLS if shutil.which(tool, path=places) is None]
    if lacking:
        return f"the virtual machine needs {', '.join(lacking)}: tools/system-packages vm"
    mirror = subprocess.run([BUILD, "mirror"], check=True, capture_output=True, text=True, timeout=60).stdout.strip()
    return "" if mirror else "this machine's package sources name no Debian mirror; set DEBIAN_MIRROR to one"


def run(folder: Path) -> tuple[dict[str, str], str]:
    """Build the machine if it is not cached, and run all of the guest's tests.

    Returns:
        The problem of each test that ran, empty for one that passed; and the machine's console output.
    """
    code = folder / "code.tar"
    with tarfile.open(code, "w") as archive:
        for name in CODE:
            archive.add(ROOT / name, name, filter=lambda entry: None if "__pycache__" in entry.name else entry)
    environment = {**os.environ, "PYTHON": sys.executable}
    subprocess.run([BUILD], check=True, timeout=BUILD_LIMIT_S, env=environment, stdout=subprocess.DEVNULL)
    try:
        subprocess.run([BUILD.with_name("run"), code, MAIN, folder], check=True, timeout=RUN_LIMIT_S, env=environment)
        ended = ""
    except subprocess.TimeoutExpired:
        ended = f"\nstopped after {RUN_LIMIT_S} s"
    console = (folder / "console.txt").read_text(errors="replace") + ended
    results = {}
    for line in (folder / "result.txt").read_text(errors="replace").splitlines():
        if line.startswith("{") and line.endswith("}"):
            result = json.loads(line)
            results[result["name"]] = result.get("problem", "")
    return results, console
