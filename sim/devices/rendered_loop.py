"""A loop of images of a scene, rendered once and kept on disk.

The folder of a loop is named by a digest of all that its images depend on. It is written atomically; a loop with
wrong checksums is rendered again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.devices.options import BOARD_SCENE, SimOptions
from sim.devices.scene_options import optics_of, scene_of
from sim.render import render_pair
from sim.rig.disturbance import TrueRig
from sim.scene.scene import Scene

# Incremented whenever the same options give other images.
RENDER_VERSION = 1

Image = NDArray[np.uint8] | NDArray[np.uint16]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """Images of both cameras, (frames, H, W) or (frames, H, W, 3), read-only."""

    left: Image
    right: Image

    def __len__(self) -> int:
        return len(self.left)

    def pair(self, index: int) -> tuple[Image, Image]:
        """Left and right image of a trigger; the first follows the last."""
        i = index % len(self.left)
        return np.asarray(self.left[i]), np.asarray(self.right[i])


@dataclass(frozen=True, slots=True, eq=False)
class Switched:
    """Successive loops: each with the trigger at which it begins, the first at 0."""

    loops: tuple[tuple[int, Loop], ...]

    def pair(self, index: int) -> tuple[Image, Image]:
        """Left and right image of a trigger."""
        return [loop for first, loop in self.loops if first <= max(0, index)][-1].pair(index)


def loops_of(options: SimOptions, progress: Progress | None = None) -> Loop | Switched:
    """The loop of these options, or one before and one after each disturbance."""
    parts = [(0, load_or_render(replace(options, disturb=()), progress))]
    for k, disturbance in enumerate(options.disturb):
        parts.append((disturbance.at, load_or_render(replace(options, disturb=options.disturb[: k + 1]), progress)))
    return Switched(tuple(parts)) if options.disturb else parts[0][1]


def load_or_render(options: SimOptions, progress: Progress | None = None) -> Loop:
    """The loop of these options, from the cache if present; ``progress(done, of)`` is called while rendering."""
    folder = folder_of(options)
    found = read(folder)
    if found is not None:
        return found
    loop = render_loop(options, progress)
    return _keep(loop, folder) or loop


def folder_of(options: SimOptions) -> Path:
    """Where the loop of these options is kept."""
    return (options.cache_dir or default_cache_dir()) / f"loop-{digest(options)[:24]}"


def default_cache_dir() -> Path:
    """``fringed`` below XDG_CACHE_HOME, or below ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "fringed"


def digest(options: SimOptions) -> str:
    """Hex digest of all that the images depend on."""
    parts: dict[str, Any] = {
        "version": RENDER_VERSION,
        "scene": options.scene,
        "mesh": hashlib.sha256(options.mesh.read_bytes()).hexdigest() if options.mesh else None,
        "seed": options.seed,
        "frames": options.frames,
        "layout": asdict(options.layout),
        "optics": asdict(options.optics),
        "encoding": options.encoding,
    }
    if options.scene == BOARD_SCENE:
        parts["board"] = [options.board, options.poses]
    if options.disturb:
        parts["disturb"] = [asdict(replace(disturbance, at=0)) for disturbance in options.disturb]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def render_loop(options: SimOptions, progress: Progress | None = None) -> Loop:
    """All images of the loop, after all disturbances."""
    pairs = []
    if progress is not None:
        progress(0, options.frames)
    for pair in rendered_pairs(options):
        pairs.append(pair)
        if progress is not None:
            progress(len(pairs), options.frames)
    return Loop(_frozen([left for left, _ in pairs]), _frozen([right for _, right in pairs]))


def rendered_pairs(options: SimOptions, first: int = 0) -> Iterator[tuple[Image, Image]]:
    """The pairs of the loop in order, from a number on; a scene at rest is rendered once and only the noise differs."""
    scene = scene_of(options)
    counts = None
    for index in range(first, options.frames):
        if counts is None or scene.moves:
            counts = _counts(options, scene, index)
        yield render_pair.with_noise(counts, options.optics, options.seed * 1_000_003 + index, options.encoding)


def time_of(options: SimOptions, scene: Scene, index: int) -> float:
    """Time in the scene at which an image of the loop starts, seconds."""
    return scene.period_s * (index % options.frames) / options.frames


def _counts(options: SimOptions, scene: Scene, index: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    t_s = time_of(options, scene, index)
    pattern, optics = options.layout.pattern(), optics_of(options)
    rig = TrueRig.of(options.layout, optics)
    for disturbance in options.disturb:
        rig = rig.after(disturbance)
    return render_pair.render_counts(options.layout, scene, pattern, optics, t_s, options.encoding, rig)


def _frozen(images: list[Image]) -> Image:
    out: Image = np.stack(images)  # type: ignore[assignment, arg-type, unused-ignore]
    out.setflags(write=False)
    return out


def read(folder: Path) -> Loop | None:
    """The loop in a folder, or None if there is none or its checksums are wrong."""
    try:
        sums = json.loads((folder / "loop.json").read_text())["crc32"]
        arrays = {side: np.load(folder / f"{side}.npy", mmap_mode="r", allow_pickle=False) for side in sums}
        if any(zlib.crc32(arrays[side].data) != value for side, value in sums.items()):
            return None
        return Loop(arrays["left"], arrays["right"])
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        return None


def _keep(loop: Loop, folder: Path) -> Loop | None:
    """Write the loop to a temporary folder and rename it; None if that fails, which costs only time."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError:
        return None
    try:
        for side, images in (("left", loop.left), ("right", loop.right)):
            _write(temporary / f"{side}.npy", images)
        finish(temporary, folder, loop)
    except OSError:
        return read(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return read(folder)


def finish(temporary: Path, folder: Path, loop: Loop) -> None:
    """Add the checksums to a temporary folder with the images of a loop, and give it its name."""
    sums = {"left": zlib.crc32(loop.left.data), "right": zlib.crc32(loop.right.data)}
    (temporary / "loop.json").write_text(json.dumps({"crc32": sums}))
    if folder.exists():
        # The existing one has wrong checksums, or another process was faster and this one is as good.
        shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


def _write(path: Path, images: Image) -> None:
    with path.open("wb") as file:
        np.save(file, images, allow_pickle=False)
        file.flush()
        os.fsync(file.fileno())
