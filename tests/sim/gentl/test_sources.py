"""The C sources of the GenTL producer call each other without a circle."""

from __future__ import annotations

import shutil
import subprocess
from graphlib import TopologicalSorter
from pathlib import Path

from sim.gentl import build
from tests.sim.gentl.needs import missing

if not (shutil.which("cc") and shutil.which("nm")):
    missing("the calls between C files are read from compiled files: cc and nm are needed")


def test_no_file_depends_on_one_that_depends_on_it(tmp_path: Path) -> None:
    defined, used = {}, {}
    for name, text in build._generated().items():
        (tmp_path / name).write_text(text)
    for source in build.SOURCES.glob("*.c"):
        compiled = tmp_path / f"{source.stem}.o"
        includes = [f"-I{tmp_path}", f"-I{build.SOURCES}"]
        subprocess.run(["cc", *build.FLAGS, "-O0", *includes, "-c", source, "-o", compiled], check=True)
        symbols = subprocess.run(["nm", compiled], capture_output=True, text=True, check=True).stdout
        entries = [line.split()[-2:] for line in symbols.splitlines()]
        used[source.stem] = {name for kind, name in entries if kind == "U"}
        defined |= {name: source.stem for kind, name in entries if kind in "TDB"}
    calls = {file: {defined[name] for name in names & defined.keys()} for file, names in used.items()}
    assert len(calls) > 10 and any(calls.values())
    assert set(TopologicalSorter(calls).static_order()) == set(calls)
