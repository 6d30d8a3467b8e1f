"""Rendered images, kept on disk: each is rendered once, for all workers and for later runs of the tests.

The digest of the renderer's sources names the folder, that of the function and its arguments the file.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim.render import render_pair as renderer
from sim.render.render_pair import RenderedPair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.scene import Scene

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / ".pytest_cache" / "renders"
SOURCES = (
    "sim/devices", "sim/render", "sim/rig", "sim/scene", "pipeline/common", "pipeline/pattern", "pipeline/rig",
)  # fmt: skip


def render_pair(
    layout: RigLayout,
    scene: Scene,
    pattern: Any,
    optics: Optics | None = None,
    t_s: float = 0.0,
    seed: int = 0,
    encoding: str = "rgb8",
) -> RenderedPair:
    """What :func:`sim.render.render_pair.render_pair` returns, for tests of which the renderer is not the subject."""
    optics = Optics() if optics is None else optics
    made: RenderedPair = stored(renderer.render_pair, layout, scene, pattern, optics, t_s, seed, encoding)
    return made


def stored(make: Callable[..., Any], *arguments: object) -> Any:
    """What ``make(*arguments)`` returns; both can be pickled, and it depends on nothing else but ``SOURCES``."""
    digest = hashlib.sha256(Path(inspect.getfile(make)).read_bytes())
    digest.update(pickle.dumps((make.__module__, make.__qualname__, arguments)))
    path = folder() / f"{digest.hexdigest()}.pickle"
    if path.exists():
        return pickle.loads(path.read_bytes())
    made = make(*arguments)
    partial = path.with_suffix(f".{os.getpid()}")
    partial.write_bytes(pickle.dumps(made, protocol=5))
    partial.replace(path)
    return made


@functools.cache
def folder() -> Path:
    """Where renders of these sources are; those of others are removed."""
    digest = hashlib.sha256()
    for name in SOURCES:
        for path in sorted((ROOT / name).rglob("*.py")):
            digest.update(path.read_bytes())
    mine = FOLDER / digest.hexdigest()[:16]
    for other in FOLDER.glob("*"):
        if other != mine:
            shutil.rmtree(other, ignore_errors=True)
    mine.mkdir(parents=True, exist_ok=True)
    return mine
