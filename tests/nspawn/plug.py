"""``python -m tests.nspawn.plug DIR NUMBER out|in``: unplugs an emulated camera of another process, or plugs it in."""

from __future__ import annotations

import socket
import struct
import sys
import time
from pathlib import Path

import numpy as np

from sim.gentl import memory


def main(directory: Path, number: int, plugged: bool) -> None:
    """Write the same state as Cable.unplug and Cable.plug."""
    state = np.memmap(directory / f"cam{number}.state", dtype=memory.STATE_DTYPE, mode="r+", shape=(1,))[0]
    if plugged:
        state["power_cycles"] = int(state["power_cycles"]) + 1
        state["clock_sequence"] = int(state["clock_sequence"]) + 1
        state["clock_base_ns"], state["clock_offset_ns"] = time.monotonic_ns(), 0
        state["clock_sequence"] = int(state["clock_sequence"]) + 1
    state["present"] = int(plugged)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as wake:
        try:
            wake.sendto(struct.pack("<Q", memory.WAKE_MAGIC), str(directory / f"cam{number}.sock"))
        except OSError:
            return  # not open in any process


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "in")
