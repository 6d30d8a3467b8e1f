"""A loop that is shown from its first image on, while a process renders the others.

The process writes into a temporary folder whose files both processes map: ``left.npy`` and ``right.npy``, of their full
size, and ``ready``, the number of images that are complete. With the last one the folder becomes that of the loop.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import child_process
from drivers.errors import DriverError
from drivers.protocols import SIDES
from sim.devices.options import SimOptions
from sim.devices.rendered_loop import Image, Loop, Progress, folder_of

READY = "ready"
_POLL_S, _END_S = 0.05, 2.0

log = logging.getLogger("fringed.sim")


class GrowingLoop:
    """Images of a loop: those that are rendered are shown forth and back, until all of them go round.

    Each image is that of the finished loop, bit by bit. Which one a trigger shows depends on the time.

    Args:
        options: of the loop, without disturbances.
        progress: called with (0, 1) while the first image is rendered, and then with (1, 1).

    Raises:
        OSError: the folder cannot be written. DriverError: the process ended before the first image.
    """

    def __init__(self, options: SimOptions, progress: Progress | None = None) -> None:
        folder = folder_of(options)
        folder.parent.mkdir(parents=True, exist_ok=True)
        self._temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            self._loop, self._ready = _new_files(options, self._temporary)
            arguments = [json.dumps(plain_values(options)), str(self._temporary), str(os.getpid())]
            self._process = child_process.start("sim.devices.loop_process", arguments)
        except BaseException:
            shutil.rmtree(self._temporary, ignore_errors=True)
            raise
        self._output = child_process.OutputReader(self._process, log, "render-output")
        try:
            self._await_first(progress)
        except BaseException:
            self.close()
            raise

    @property
    def ready(self) -> int:
        """Number of images that are rendered."""
        return int(self._ready[0])

    def pair(self, index: int) -> tuple[Image, Image]:
        """Left and right image of a trigger."""
        return self._loop.pair(shown(index, self.ready, len(self._loop)))

    def close(self) -> None:
        """End the process; an unfinished loop is removed."""
        self._process.terminate()
        child_process.end(self._process, _END_S)
        self._output.join(_END_S)
        shutil.rmtree(self._temporary, ignore_errors=True)

    def _await_first(self, progress: Progress | None) -> None:
        while not self.ready:
            if progress is not None:
                progress(0, 1)
            if self._process.poll() is not None and not self.ready:
                self._output.join(_END_S)
                raise DriverError(f"the process that renders the simulated rig ended: {self._output.text()}")
            time.sleep(_POLL_S)
        if progress is not None:
            progress(1, 1)


def shown(index: int, ready: int, frames: int) -> int:
    """Number of the image that a trigger shows while the first ``ready`` ones of ``frames`` are rendered."""
    if ready >= frames:
        return index % frames
    step = index % max(1, 2 * ready - 2)
    return min(step, 2 * ready - 2 - step) if ready > 1 else 0


def plain_values(options: SimOptions) -> dict[str, object]:
    """The options that images depend on, for :func:`sim.devices.options.from_mapping`."""
    names = "scene", "seed", "frames", "encoding", "board", "poses"
    paths = {name: str(path.resolve()) for name in ("mesh", "cache_dir") if (path := getattr(options, name))}
    structures = {"layout": asdict(options.layout), "optics": asdict(options.optics)}
    return {name: getattr(options, name) for name in names} | structures | paths


def open_files(folder: Path) -> tuple[Loop, NDArray[np.uint16]]:
    """The images of a temporary folder, and the number of those that are complete, (1,); both can be written."""
    left, right = (np.lib.format.open_memmap(folder / f"{side}.npy", "r+") for side in SIDES)
    return Loop(left, right), np.memmap(folder / READY, np.uint16, "r+", shape=(1,))


def _new_files(options: SimOptions, folder: Path) -> tuple[Loop, NDArray[np.uint16]]:
    """The same, of new files that occupy all of their space; this process only reads them."""
    columns, rows = options.layout.camera_size
    shape = (options.frames, rows, columns, *((3,) if options.encoding == "rgb8" else ()))
    dtype = np.uint16 if options.encoding.endswith("16") else np.uint8
    for side in SIDES:
        path = folder / f"{side}.npy"
        np.lib.format.open_memmap(path, "w+", dtype, shape)
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)  # a full disk is an error here, later a signal
    (folder / READY).write_bytes(bytes(2))
    left, right = (np.load(folder / f"{side}.npy", mmap_mode="r", allow_pickle=False) for side in SIDES)
    return Loop(left, right), np.memmap(folder / READY, np.uint16, "r", shape=(1,))
