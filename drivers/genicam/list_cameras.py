"""The process that lists cameras: ``python -m drivers.genicam.list_cameras FD PRODUCER...``.

Writes the list as JSON to file descriptor FD; standard output belongs to the producers' messages.
"""

from __future__ import annotations

import sys

import msgspec
from harvesters.core import Harvester

from drivers.genicam.listing import describe


def main() -> None:
    """Write the list."""
    fd, *producers = sys.argv[1:]
    harvester = Harvester()
    for producer in producers:
        harvester.add_file(producer)
    harvester.update()
    cameras = [describe(device) for device in harvester.device_info_list]
    with open(int(fd), "wb") as out:  # noqa: PTH123 - a file descriptor
        out.write(msgspec.json.encode(cameras))
    harvester.reset()


if __name__ == "__main__":
    main()
