"""A program with one camera open, for tests with several processes.

``python -m tests.sim.gentl.holder PRODUCER SERIAL`` opens the camera, arms it, prints ``armed`` and then a line of
JSON for each frame: number, time and first byte. It ends with its standard input.
"""

from __future__ import annotations

import json
import select
import sys
from pathlib import Path

from tests.sim.gentl.host import opened


def main(producer: str, serial: str) -> None:
    """Hold the camera until standard input is closed."""
    with opened(Path(producer), serial) as (host,):
        host.trigger_on()
        host.set(PixelFormat="Mono8")
        host.start()
        sys.stdout.write("armed\n")
        sys.stdout.flush()
        while not select.select([sys.stdin], [], [], 0)[0]:
            capture = host.capture(0.02)
            if capture is not None:
                expected = {"frame_id": capture.frame_id, "timestamp": capture.timestamp, "first": capture.bytes[0]}
                sys.stdout.write(json.dumps(expected) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
