"""Compile the GenTL producer into the user's cache; ``python -m sim.gentl.build`` prints its path."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from sim.gentl import features, memory

SOURCES = Path(__file__).parent / "src"
FLAGS = ("-std=gnu11", "-O2", "-ftree-vectorize", "-Wall", "-Wextra", "-Werror", "-fPIC", "-fvisibility=hidden")
LINK = ("-shared", "-pthread", "-ldl", "-lm")
LIBRARY = "fringed.cti"


class BuildError(RuntimeError):
    """The producer cannot be compiled; the message gives the reason and the next step."""


class NoCompilerError(BuildError):
    """No C compiler is installed."""


def build(directory: Path | None = None, *, extra_flags: tuple[str, ...] = ()) -> Path:
    """Compile the producer unless it exists already, and return its path.

    Args:
        directory: for it, the user's cache by default; it lies there in one named by the digest of the sources.
        extra_flags: for the compiler, for instance ``-fsanitize=address``.

    Raises:
        NoCompilerError: no C compiler is installed.
        BuildError: the sources do not compile.
    """
    generated = _generated()
    sources = {path.name: path.read_text() for path in sorted(SOURCES.iterdir()) if path.suffix in (".c", ".h")}
    library = (directory or _cache()) / f"gentl-{_digest(sources | generated, extra_flags)}" / LIBRARY
    if library.exists():
        return library
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise NoCompilerError(
            f"the GenTL producer for {library} needs a C compiler and none is installed ('cc', or what CC names); "
            "install one, for instance with: tools/system-packages compiler"
        )
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fringed-gentl-") as scratch:
        for name, text in generated.items():
            (Path(scratch) / name).write_text(text)
        compiled = Path(scratch) / LIBRARY
        units = [str(SOURCES / name) for name in sources if name.endswith(".c")]
        command = [compiler, *FLAGS, *extra_flags, f"-I{scratch}", f"-I{SOURCES}", *units, "-o", str(compiled), *LINK]
        result = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        if result.returncode:
            raise BuildError(f"the GenTL producer does not compile:\n{' '.join(command)}\n{result.stderr}")
        _install(compiled, library)
    return library


def _install(compiled: Path, library: Path) -> None:
    """Write under a temporary name first, so that other processes find no library or the whole one."""
    with tempfile.NamedTemporaryFile(dir=library.parent, prefix=".making-", delete=False) as temporary:
        temporary.write(compiled.read_bytes())
    Path(temporary.name).chmod(0o755)
    Path(temporary.name).replace(library)


def _generated() -> dict[str, str]:
    """The C headers generated from Python's tables."""
    texts = {
        "camera_xml": features.CAMERA_XML,
        "old_camera_xml": features.OLD_CAMERA_XML,
        "stream_xml": features.STREAM_XML,
    }
    formats = [f"#define PF_{name} 0x{value:08X}u" for name, value in features.PIXEL_FORMATS.items()]
    return {
        "registers.h": features.REGISTERS.header() + features.STREAM_REGISTERS.header() + "\n".join(formats) + "\n",
        "state.h": memory.header(),
        "formats.h": _formats(),
        "descriptions.h": "\n".join(f"static const char {name}[] =\n{_literal(text)};" for name, text in texts.items()),
    }


def _formats() -> str:
    """Filter, depth, samples a pixel and packing of each pixel format."""
    rows = []
    for name, value in features.PIXEL_FORMATS.items():
        pattern = memory.FILTERS.index(name[5:7]) if name.startswith("Bayer") else 0
        depth = int("".join(letter for letter in name if letter.isdigit()))
        rows.append(
            f"    {{ 0x{value:08X}u, {pattern}, {depth}, {3 if name == 'RGB8' else 1}, {int(name[-1] == 'p')} }},"
        )
    fields = "typedef struct { uint32_t number, filter, depth, samples, packed; } Format;"
    return "\n".join(["#include <stdint.h>", fields, "static const Format formats[] = {", *rows, "};", ""])


def _literal(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return "\n".join(f'"{line}\\n"' for line in escaped.splitlines())


def _digest(files: dict[str, str], extra_flags: tuple[str, ...]) -> str:
    digest = hashlib.sha256(repr((FLAGS, LINK, extra_flags)).encode())
    for name, text in sorted(files.items()):
        digest.update(f"{name}\0{text}\0".encode())
    return digest.hexdigest()[:16]


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "fringed"


if __name__ == "__main__":
    sys.stdout.write(f"{build()}\n")
