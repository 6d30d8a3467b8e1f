"""A loop that is shown from its first image on, while a process renders the others.

The process writes into a temporary folder whose files both processes map: ``left.npy`` and ``right.npy``, of their full
size, ``sums.npy``, the checksums of the images, and ``ready``, the number of those that are complete. With the last one
the folder becomes that of the loop. A loop that is ended before is kept, and the next one goes on with it.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import tempfile
import time
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers import child_process
from drivers.errors import DriverError
from drivers.protocols import SIDES
from sim.devices.options import SimOptions
from sim.devices.rendered_loop import Image, Loop, Progress, folder_of

READY, SUMS = "ready", "sums"
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
        self._folder = folder
        self._temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            self._loop, self._ready = _kept_files(options, self._temporary) or _new_files(options, self._temporary)
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
        """End the process; the images of an unfinished loop are kept for the next one."""
        self._process.terminate()
        child_process.end(self._process, _END_S)
        self._output.join(_END_S)
        keep_unfinished(self._temporary, self._folder)

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


def open_files(folder: Path) -> tuple[Loop, NDArray[np.uint16], NDArray[np.uint32]]:
    """The images of a temporary folder, the number of those that are complete, (1,), and the checksums (frames, 2).

    All can be written.
    """
    left, right, sums = (np.lib.format.open_memmap(folder / f"{name}.npy", "r+") for name in (*SIDES, SUMS))
    return Loop(left, right), np.memmap(folder / READY, np.uint16, "r+", shape=(1,)), sums


def sums_of(loop: Loop, index: int) -> tuple[int, int]:
    """Checksums of the left and the right image of this number."""
    return zlib.crc32(loop.left[index].data), zlib.crc32(loop.right[index].data)


def keep_unfinished(temporary: Path, folder: Path) -> None:
    """Give a temporary folder with some images the name under which the next loop finds them, or remove it."""
    try:
        if any((temporary / READY).read_bytes()):
            shutil.rmtree(_unfinished(folder), ignore_errors=True)
            temporary.rename(_unfinished(folder))
    except OSError:
        pass  # finished, or another process keeps its own
    shutil.rmtree(temporary, ignore_errors=True)


def _unfinished(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}-unfinished")


def _kept_files(options: SimOptions, folder: Path) -> tuple[Loop, NDArray[np.uint16]] | None:
    """The files of a loop that was ended before, moved to this folder; None if there are none as they should be."""
    shape, dtype = _format_of(options)
    try:
        _unfinished(folder_of(options)).rename(folder)
        loop, ready, sums = open_files(folder)
        if any(images.shape != shape or images.dtype != dtype for images in (loop.left, loop.right)):
            return None
        found = min(int(ready[0]), options.frames)
        ready[0] = next((k for k in range(found) if sums_of(loop, k) != tuple(sums[k])), found)
    except (OSError, ValueError, EOFError, IndexError):
        return None
    return _read_files(folder) if ready[0] else None


def _format_of(options: SimOptions) -> tuple[tuple[int, ...], Any]:
    """Shape and type of the images of one camera."""
    columns, rows = options.layout.camera_size
    shape = (options.frames, rows, columns, *((3,) if options.encoding == "rgb8" else ()))
    return shape, np.dtype(np.uint16 if options.encoding.endswith("16") else np.uint8)


def _new_files(options: SimOptions, folder: Path) -> tuple[Loop, NDArray[np.uint16]]:
    """The same, of new files that occupy all of their space."""
    shape, dtype = _format_of(options)
    for side in SIDES:
        path = folder / f"{side}.npy"
        np.lib.format.open_memmap(path, "w+", dtype, shape)
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)  # a full disk is an error here, later a signal
    np.save(folder / f"{SUMS}.npy", np.zeros((options.frames, 2), np.uint32))
    (folder / READY).write_bytes(bytes(2))
    return _read_files(folder)


def _read_files(folder: Path) -> tuple[Loop, NDArray[np.uint16]]:
    """Images and their number; this process only reads them."""
    left, right = (np.load(folder / f"{side}.npy", mmap_mode="r", allow_pickle=False) for side in SIDES)
    return Loop(left, right), np.memmap(folder / READY, np.uint16, "r", shape=(1,))
