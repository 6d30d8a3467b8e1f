"""The GenICam library: installed, and loadable by this Python, checked in another process."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import elf
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import ProgramResult, run_program
from drivers.child_process import interpreter

area = Area("library")

PACKAGES = "genicam", "harvesters"
_IMPORT = "import genicam.genapi, genicam.gentl, harvesters.core"
_TIMEOUT_S = 45.0


def check(subject: Subject) -> Iterator[Finding]:
    """Check the packages, their shared libraries, and their import in another process."""
    certain = subject.uses("genicam")
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        text = f"no Python package {' and '.join(missing)}: GenICam cameras cannot be used"
        yield area.graded("packages", text, "pip install fringed-rig", certain=certain)
        return
    yield import_finding(
        needed_python(package_dir("genicam")), run_program([*interpreter(), "-c", _IMPORT], _TIMEOUT_S), certain
    )


def package_dir(name: str) -> Path:
    """The directory of a package, determined without importing it."""
    spec = importlib.util.find_spec(name)
    locations = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(locations[0]) if locations else Path()


def needed_python(directory: Path) -> str:
    """The interpreter's shared library against which a package's libraries are linked, empty if none."""
    for path in sorted(directory.glob("*.so"))[:64]:
        try:
            names = elf.read(path).needed
        except (elf.ElfError, OSError):
            continue
        for name in names:
            if name.startswith("libpython"):
                return name
    return ""


def import_finding(library: str, attempt: ProgramResult, certain: bool) -> Finding:
    """The finding for the attempted import."""
    if attempt.status == 0:
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
        return area.ok("import", f"{versions} load{f'; {library} is installed' if library else ''}")
    if library and library in attempt.err:
        package = library.partition(".so")[0]
        text = f"the genicam package needs {library}, which is not installed"
        return area.graded("libpython", text, f"sudo apt install {package}", certain=certain)
    remedy = f"pip install --force-reinstall genicam harvesters; then try: {sys.executable} -c '{_IMPORT}'"
    return area.graded("import", f"the GenICam library does not load: {attempt.problem}", remedy, certain=certain)
