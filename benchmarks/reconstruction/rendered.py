"""Rendered images on disk, which benchmarks share and which change only with the renderer.

They lie in ``out/bench/images``, in a folder named by a digest of the source that they depend on; folders of other
digests are removed.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pipeline
import sim
from benchmarks.reconstruction.cases import Case
from sim.render.ground_truth import Truth
from sim.render.render_pair import render_pair
from sim.scene.named_scenes import build

OUT = Path(__file__).resolve().parents[2] / "out" / "bench"
_RENDERER = ("render", "rig", "scene")
_OF_PIPELINE = ("rig/calibration.py", "rig/camera_model.py", "pattern/color_fringe.py")


@dataclass(frozen=True, slots=True, eq=False)
class StoredPair:
    """A pair of images with the left camera's truth, and their file."""

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth_left: Truth
    file: Path


def stored_pair(
    case: Case, seed: int = 0, t_s: float = 0.0, noise: int | None = None, folder: Path | None = None
) -> StoredPair:
    """The images of a case, from disk if present; textures of ``seed``, and its noise unless ``noise`` is given."""
    folder = folder or _folder()
    noise = seed if noise is None else noise
    file = folder / f"{_key(case, seed, t_s, noise)}.npz"
    if not file.exists():
        scene = build(case.scene, seed=seed)
        pair = render_pair(case.layout, scene, case.pattern, case.optics, t_s, noise, case.encoding)
        _keep(file, {"left": pair.left, "right": pair.right} | pair.truth_left.arrays())
    with np.load(file) as arrays:
        truth = Truth(**{item.name: arrays[item.name] for item in fields(Truth)})
        return StoredPair(arrays["left"], arrays["right"], truth, file)


def _keep(file: Path, arrays: dict[str, Any]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, prefix=".", delete=False) as temporary:
        try:
            np.savez(temporary, **arrays)
        except BaseException:
            Path(temporary.name).unlink(missing_ok=True)
            raise
    Path(temporary.name).replace(file)


def _key(case: Case, seed: int, t_s: float, noise: int) -> str:
    # The depth of the volume concerns only the reconstruction: the same images serve every depth.
    layout = astuple(replace(case.layout, depth_mm=1.0))
    parts = (case.scene, layout, astuple(case.optics), case.encoding, case.modulated, case.periods, seed, t_s, noise)
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _folder() -> Path:
    folder = OUT / "images" / source_digest()
    for other in folder.parent.glob("*"):
        if other != folder:
            shutil.rmtree(other, ignore_errors=True)
    return folder


def source_digest() -> str:
    """Digest of every source file that the images depend on."""
    files = [file for folder in _RENDERER for file in sorted((Path(sim.__file__).parent / folder).rglob("*.py"))]
    files += [Path(pipeline.__file__).parent / name for name in _OF_PIPELINE]
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def moving(frames: int, rate_hz: float) -> tuple[Case, list[StoredPair]]:
    """Successive images of the moving scene at this rate."""
    case = Case("moving", "moving")
    return case, [stored_pair(case, t_s=0.4 + i / rate_hz, noise=i) for i in range(frames)]
