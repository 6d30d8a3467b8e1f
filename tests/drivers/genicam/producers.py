"""The producers that the driver is tried with, and what each of them can do, as data.

* ``ours`` and ``ours_old``: emulated triggered cameras of this project, with modern and with old feature names.
* ``viky``: the demonstration producer inside the genicam package: runs freely, has no trigger and no time stamps.
* ``tlsimu``: the demonstration producer of genicam 1.5.0, fetched from the package index into the user's cache.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from sim.gentl.build import BuildError, build
from sim.gentl.cable import Cable

_OLD_GENICAM = "1.5.0"


@dataclass(frozen=True)
class Ability:
    """What a producer's cameras do.

    Args:
        name: of the producer. cameras: how many it has. select: options that fit exactly one of them.
        spare: options that fit exactly one other. several: options that fit more than one.
        trigger: how frames are had in a test. model, size, encoding: of the selected one.
        stamps: frames carry the camera's time. latches: the camera's clock can be read.
        ids: it counts frames. holes: the count may jump, as it runs freely faster than it is read.
        exclusive: a second process is refused. temperature: it has a thermometer.
    """

    name: str
    cameras: int
    select: dict[str, Any]
    spare: dict[str, Any]
    several: dict[str, Any]
    trigger: dict[str, Any]
    model: str
    size: tuple[int, int]
    encoding: str
    options: dict[str, Any] = field(default_factory=dict)
    stamps: bool = True
    latches: bool = False
    ids: bool = True
    holes: bool = False
    exclusive: bool = True
    temperature: bool = False


SOFTWARE = {"source": "software", "rate_hz": 50.0}
OURS = Ability(
    name="ours",
    cameras=2,
    select={"serial": "A1"},
    spare={"serial": "A2"},
    several={"model": "FringedCam"},
    trigger=SOFTWARE,
    model="FringedCam",
    size=(64, 48),
    encoding="bayer_rggb8",
    options={"pixel_format": "BayerRG8", "exposure_us": 1000.0},
    latches=True,
    temperature=True,
)
OURS_OLD = Ability(
    name="ours_old",
    cameras=2,
    select={"serial": "A1"},
    spare={"serial": "A2"},
    several={"model": "FringedCam"},
    trigger=SOFTWARE,
    model="FringedCam",
    size=(64, 48),
    encoding="rgb8",
    options={"pixel_format": "RGB8", "exposure_us": 1000.0},
    latches=True,
)
VIKY = Ability(
    name="viky",
    cameras=3,
    select={"serial": "0"},
    spare={"serial": "1"},
    several={"model": "Viky"},
    trigger={"source": "free_run"},
    model="Viky",
    size=(400, 400),
    encoding="mono8",
    options={"pixel_format": "Mono8"},
    stamps=False,
    holes=True,
    exclusive=False,
)
TLSIMU = Ability(
    name="tlsimu",
    cameras=4,
    select={"serial": "SN_InterfaceA_0"},
    spare={"serial": "SN_InterfaceA_1"},
    several={"model": "TLSimuMono"},
    trigger=SOFTWARE,
    model="TLSimuMono",
    size=(512, 512),
    encoding="mono8",
    options={"pixel_format": "Mono8"},
    exclusive=False,
)
ALL = (OURS, OURS_OLD, VIKY, TLSIMU)


@contextmanager
def cables(directory: Path, *, old: bool = False, **options: Any) -> Iterator[tuple[Cable, Cable]]:
    """Two emulated cameras, A1 and A2, plugged in."""
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(Cable(directory, k, serial=f"A{k + 1}", old=old, **{"size": (64, 48), **options}))
            for k in range(2)
        )
        yield first, second


def library(name: str) -> Path:
    """The producer's .cti; skips (in CI: fails) where it cannot be had."""
    if name.startswith("ours"):
        try:
            return build()
        except BuildError as error:
            missing(str(error))
    if name == "viky":
        package = importlib.util.find_spec("genicam")
        if package is None or not package.submodule_search_locations:
            missing("the genicam package is not installed")
        path = Path(package.submodule_search_locations[0]) / "viky.cti"
        return path if path.is_file() else missing(f"this genicam has no {path.name}")
    return _tlsimu()


def missing(why: str) -> Any:
    """Nothing is passed over silently where everything must be there."""
    if os.environ.get("CI"):
        pytest.fail(why)
    pytest.skip(why)


def _tlsimu() -> Path:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fringed" / f"tlsimu-{_OLD_GENICAM}"
    path = cache / "TLSimu.cti"
    if path.is_file():
        return path
    cache.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache.parent) as scratch:
        wanted = ["--no-deps", "--only-binary=:all:", "--python-version=3.11", "--platform=manylinux2014_x86_64"]
        command = [sys.executable, "-m", "pip", "download", "--quiet", *wanted, "--dest", scratch]
        result = subprocess.run(
            [*command, f"genicam=={_OLD_GENICAM}"], capture_output=True, text=True, check=False, timeout=100
        )
        if result.returncode:
            missing(f"genicam {_OLD_GENICAM}, which has the TLSimu producer, cannot be fetched: {result.stderr[-500:]}")
        made = Path(scratch) / "made"
        made.mkdir()
        with zipfile.ZipFile(next(Path(scratch).glob("genicam-*.whl"))) as wheel:
            for member in wheel.namelist():
                if member.endswith(("/TLSimu.cti", "/libVirtualFG.so")):
                    (made / Path(member).name).write_bytes(wheel.read(member))
        try:
            made.rename(cache)
        except OSError:  # another process was quicker
            if not path.is_file():
                raise
    return path
