"""GenTL producers, the camera vendors' libraries: present, built for this processor, and loadable."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.cameras import elf
from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.run_program import run_program
from drivers.genicam.options import PRODUCER_PATH, Options, producers

area = Area("producers")

_LOAD = "import ctypes, sys; library = ctypes.CDLL(sys.argv[1]); library.GCInitLib; library.TLOpen"
_TIMEOUT_S = 15.0
_INSTALL = f"install the camera vendor's GenTL producer; set {PRODUCER_PATH} to its directory"


def check(subject: Subject) -> Iterator[Finding]:
    """Check the producers that the environment and rig.yaml name."""
    yield from search_path(subject)
    certain = subject.uses("genicam")
    for side, camera in subject.cameras.items():
        if not isinstance(camera, Options):
            continue
        try:
            producers(camera.producer, subject.base_dir, subject.machine.environ)
        except (ValueError, OSError) as error:
            remedy = _INSTALL if not camera.producer else f"correct cameras.{side}.producer, or {_INSTALL}"
            yield area.problem(f"camera {side}", f"camera {side}: {str(error).partition(';')[0]}", remedy)
    if not subject.producers and not certain:
        yield area.note("none", "no GenTL producer, so GenICam cameras cannot be detected", _INSTALL)
    for path in subject.producers:
        yield producer(path, certain)


def search_path(subject: Subject) -> Iterator[Finding]:
    """Check the directories of the environment variable: missing or empty ones."""
    for part in filter(None, subject.machine.environ.get(PRODUCER_PATH, "").split(os.pathsep)):
        directory = Path(part)
        text = ""
        if not directory.is_dir():
            text = f"{PRODUCER_PATH} names {directory}, which does not exist"
        elif not any(directory.glob("*.cti")):
            text = f"{PRODUCER_PATH} names {directory}, which contains no .cti file"
        if text:
            yield area.warning("path", text, f"correct {PRODUCER_PATH}")


def producer(path: Path, certain: bool) -> Finding:
    """Check one producer."""
    try:
        library = elf.read(path)
    except (elf.ElfError, OSError) as error:
        remedy = f"reinstall the vendor's producer for Linux: {path}"
        return area.graded(path.name, str(error), remedy, certain=certain)
    if not library.fits:
        text = f"{path} is built for {library.machine}, not for this machine"
        return area.graded(path.name, text, "install the vendor's package for this processor", certain=certain)
    attempt = run_program([sys.executable, "-c", _LOAD, str(path)], _TIMEOUT_S)
    if attempt.status == 0:
        return area.ok(path.name, f"{path} loads")
    remedy = f"list its missing libraries with: ldd {path}; install them, or reinstall the vendor's package"
    return area.graded(path.name, f"{path} does not load: {attempt.problem}", remedy, certain=certain)
