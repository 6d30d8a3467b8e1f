"""Process that renders a loop for :mod:`sim.devices.growing_loop`; it ends with its parent.

The first image has the priority of the parent, the others the lowest.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

from drivers.child_process import set_death_signal
from sim.devices.growing_loop import READY, SUMS, keep_unfinished, open_files, sums_of
from sim.devices.options import from_mapping
from sim.devices.rendered_loop import finish, folder_of, rendered_pairs

_LOWEST_PRIORITY = 19


def main() -> None:
    """Render what is not rendered yet, and give the folder its name; what there is at an earlier end is kept."""
    values, name, parent = sys.argv[1:]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    set_death_signal(signal.SIGTERM)
    temporary, options = Path(name), from_mapping(json.loads(values))
    try:
        if os.getppid() != int(parent):
            sys.exit("the process that started this one is gone")
        loop, ready, sums = open_files(temporary)
        for index, (left, right) in enumerate(rendered_pairs(options, int(ready[0])), int(ready[0])):
            loop.left[index], loop.right[index] = left, right
            sums[index] = sums_of(loop, index)
            ready[0] = index + 1
            os.nice(_LOWEST_PRIORITY)
        for path in temporary.glob("*.npy"):
            with path.open("rb") as file:
                os.fsync(file.fileno())
        for name in (READY, f"{SUMS}.npy"):
            (temporary / name).unlink()
        finish(temporary, folder_of(options), loop)
    finally:
        keep_unfinished(temporary, folder_of(options))


if __name__ == "__main__":
    main()
