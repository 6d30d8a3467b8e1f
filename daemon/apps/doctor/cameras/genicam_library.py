"""The GenICam library: installed, and loadable beside this Python; told without loading it here."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import elf
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import Answer, ask

area = Area("library")

PACKAGES = "genicam", "harvesters"
_IMPORT = "import genicam.genapi, genicam.gentl, harvesters.core"
_TIMEOUT_S = 45.0


def check(subject: Subject) -> Iterator[Finding]:
    """Packages, their shared libraries, and an import in another process."""
    certain = subject.uses("genicam")
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        text = f"no Python package {' and '.join(missing)}: GenICam cameras cannot be used"
        yield area.trouble("packages", text, "pip install 'fringed[rig]'", certain=certain)
        return
    yield judged(needed_python(package_dir("genicam")), ask([sys.executable, "-c", _IMPORT], _TIMEOUT_S), certain)


def package_dir(name: str) -> Path:
    """Where a package lies, found without importing it."""
    spec = importlib.util.find_spec(name)
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(places[0]) if places else Path()


def needed_python(directory: Path) -> str:
    """The interpreter's shared library that a package's own libraries are linked with, empty if none."""
    for path in sorted(directory.glob("*.so"))[:64]:
        try:
            names = elf.read(path).needed
        except (elf.ElfError, OSError):
            continue
        for name in names:
            if name.startswith("libpython"):
                return name
    return ""


def judged(library: str, tried: Answer, certain: bool) -> Finding:
    """What the attempt to import it says."""
    if tried.status == 0:
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
        return area.ok("import", f"{versions} load{f'; {library} is there' if library else ''}")
    if library and library in tried.err:
        package = library.partition(".so")[0]
        text = f"the genicam package needs {library}, which this machine does not have"
        return area.trouble("libpython", text, f"sudo apt install {package}", certain=certain)
    remedy = f"pip install --force-reinstall genicam harvesters; then try: {sys.executable} -c '{_IMPORT}'"
    return area.trouble("import", f"the GenICam library does not load: {tried.why}", remedy, certain=certain)
