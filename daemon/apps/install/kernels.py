"""Compilation of the kernels ahead of the service's first start, as the service's user."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.apps.install.environment import OWN
from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import CACHE, KERNELS, STATE, USER
from daemon.apps.install.target import Target

if TYPE_CHECKING:
    from sim.render.render_pair import RenderedPair
    from sim.rig.layout import RigLayout

ENCODINGS = "rgb8", "bayer_rggb8"
_TIMEOUT_S = 3600
_PROGRAM = """
import sys
from daemon.cli.allocator import prepare
prepare()
from daemon.apps.install.kernels import compile_all
compile_all(sys.argv[1:])
"""


def compile_ahead(target: Target, modes: Sequence[str] = ()) -> None:
    """Compile with the installed environment; as root, with the service's user.

    Args:
        modes: multi-frame modes, in addition to the single shot.
    """
    python = target.prefix / "env/bin/python"
    user: dict[str, object] = {}
    if os.geteuid() == 0:
        ids = target.number("passwd", USER), target.number("group", USER)
        user = {"user": ids[0], "group": ids[1], "extra_groups": []}
    environment = {
        "PATH": os.environ.get("PATH", "/usr/bin:/bin"),
        "HOME": str(STATE),
        "XDG_CACHE_HOME": str(CACHE.parent),
        "NUMBA_CACHE_DIR": str(KERNELS),
    }
    process = subprocess.run(
        [str(python), "-P", "-c", _PROGRAM, *modes], env=environment, cwd="/", stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=_TIMEOUT_S, check=False, umask=0o027, **user,
    )  # type: ignore[call-overload]  # fmt: skip
    if process.returncode:
        raise InstallError(f"the compilation of the kernels failed:\n{process.stderr.strip()[-2000:]}")


def copy_compiled(target: Target) -> int:
    """Copy the running program's compiled kernels of the same sources; returns the number of files.

    numba compares time and size of each source before it uses a file, so an outdated one is compiled again.
    """
    from numba.core import caching

    # numba below 0.62 has the name with an underscore.
    locator = getattr(caching, "UserProvidedCacheLocator", None) or caching._UserProvidedCacheLocator
    root, count = Path(__file__).resolve().parents[3], 0
    (own,) = target.path(target.prefix / "env").glob("lib/python3.*/site-packages")
    own = Path("/") / own.relative_to(target.root)
    for package in OWN:
        for folder in sorted({path.parent for path in (root / package).rglob("*.py")}):
            for cached in (folder / "__pycache__").glob("*.nb[ic]"):
                sub = locator.get_suitable_cache_subpath(str(own / folder.relative_to(root) / "any.py"))
                destination = target.path(KERNELS) / sub
                destination.mkdir(parents=True, exist_ok=True)
                shutil.copy2(cached, destination)
                count += 1
    assign_to_service(target)
    return count


def assign_to_service(target: Target) -> None:
    """Give the cache to the service's user."""
    if os.geteuid() != 0:
        return
    user, group = target.number("passwd", USER), target.number("group", USER)
    for path in (target.path(KERNELS), *target.path(KERNELS).rglob("*")):
        os.chown(path, user, group, follow_symlinks=False)


def small_layout() -> RigLayout:
    """The rig used for the compilation."""
    from sim.rig.layout import RigLayout

    return RigLayout().scaled(0.125)


def small_pair(encoding: str) -> RenderedPair:
    """Render images of that rig, which compiles the renderer."""
    from sim.render.render_pair import render_pair
    from sim.rig.optics import Optics
    from sim.scene.named_scenes import build

    layout = small_layout()
    return render_pair(layout, build("moving"), layout.pattern(), Optics(), encoding=encoding)


def compile_all(modes: Sequence[str] = ()) -> None:
    """Compile the kernels of the pipeline and of the simulation; runs in the installed environment.

    Args:
        modes: as of :func:`compile_ahead`.
    """
    from pipeline.monitor.observe import warm_up
    from pipeline.reconstruct.reconstructor import Reconstructor
    from sim.rig.optics import Optics

    layout = small_layout()
    for encoding in ENCODINGS:
        reconstructor = Reconstructor(
            layout.calibration_for(Optics()), layout.pattern(), layout.volume(), encoding=encoding
        )
        reconstructor.warm_up(strides=(1, 2), use_prior=True)
        pair = small_pair(encoding)
        reconstructor.reconstruct(pair.left, pair.right)
    warm_up()
    compile_modes([(mode, encoding) for mode in modes for encoding in ENCODINGS])


def compile_modes(modes: Iterable[tuple[str, str]]) -> None:
    """Compile the kernels of multi-frame modes, given as mode and encoding."""
    from pipeline.multi_frame.set_reconstructor import SetReconstructor
    from pipeline.pattern.mode_sequences import mode_sequence
    from sim.rig.optics import Optics

    layout = small_layout()
    calibration = layout.calibration_for(Optics())
    for mode, encoding in modes:
        sequence = mode_sequence(mode, layout.projector_size, periods=layout.periods)
        SetReconstructor(calibration, sequence, layout.volume(), encoding=encoding).warm_up()
