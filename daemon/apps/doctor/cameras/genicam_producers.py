"""GenTL producers, the camera vendors' libraries: found, for this processor, and loadable."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import elf
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import ask
from drivers.genicam.options import PRODUCER_PATH
from drivers.genicam.options import producers as producers_of

area = Area("producers")

_LOAD = "import ctypes, sys; library = ctypes.CDLL(sys.argv[1]); library.GCInitLib; library.TLOpen"
_TIMEOUT_S = 15.0
_INSTALL = f"install the camera vendor's GenTL producer; set {PRODUCER_PATH} to its directory"


def check(subject: Subject) -> Iterator[Finding]:
    """Those that the environment and rig.yaml name."""
    yield from search_path(subject)
    certain = subject.uses("genicam")
    for side, camera in subject.cameras.items() if certain else ():
        try:
            producers_of(camera.producer, subject.base_dir, subject.machine.environ)
        except (ValueError, OSError) as error:
            remedy = _INSTALL if not camera.producer else f"correct cameras.{side}.producer, or {_INSTALL}"
            yield area.problem(f"camera {side}", f"camera {side}: {str(error).partition(';')[0]}", remedy)
    if not subject.producers and not certain:
        yield area.note("none", "no GenTL producer, so no GenICam camera can be seen", _INSTALL)
    for path in subject.producers:
        yield producer(path, certain)


def search_path(subject: Subject) -> Iterator[Finding]:
    """Directories of the environment variable that are not there, or empty."""
    for part in filter(None, subject.machine.environ.get(PRODUCER_PATH, "").split(os.pathsep)):
        place = Path(part)
        if not place.is_dir():
            yield area.warning("path", f"{PRODUCER_PATH} names {place}, which is not there", f"correct {PRODUCER_PATH}")
        elif not any(place.glob("*.cti")):
            yield area.warning("path", f"{PRODUCER_PATH} names {place}, where no .cti is", f"correct {PRODUCER_PATH}")


def producer(path: Path, certain: bool) -> Finding:
    """One producer."""
    try:
        library = elf.read(path)
    except (elf.ElfError, OSError) as error:
        return area.trouble(
            path.name, str(error), f"install the vendor's producer for Linux anew: {path}", certain=certain
        )
    if not library.fits:
        text = f"{path} is made for {library.machine}, not for this machine"
        return area.trouble(path.name, text, "install the vendor's package for this processor", certain=certain)
    tried = ask([sys.executable, "-c", _LOAD, str(path)], _TIMEOUT_S)
    if tried.status == 0:
        return area.ok(path.name, f"{path} loads")
    remedy = f"see what it misses with: ldd {path}; install it, or the vendor's package anew"
    return area.trouble(path.name, f"{path} does not load: {tried.why}", remedy, certain=certain)
