"""Runs every ``test_*`` of the guest's modules and prints one line of JSON for each."""

from __future__ import annotations

import faulthandler
import importlib
import json
import subprocess
import sys
import time
import traceback

MODULES = ("vivid", "loopback")
DRIVERS = (
    "vivid n_devs=3 node_types=0x1,0x1,0x1 num_inputs=1,1,1 input_types=0,0,0 multiplanar=1,1,2",
    "v4l2loopback devices=2 video_nr=40,41 card_label=loop-left,loop-right max_buffers=8",
)
LONGEST_S = 120


def report(result: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(result) + "\n")
    sys.stdout.flush()


def main() -> None:
    for driver in DRIVERS:
        subprocess.run(["modprobe", *driver.split()], check=True)
    for name in MODULES:
        module = importlib.import_module(f"tests.drivers.v4l2.guest.{name}")
        for test in [key for key in vars(module) if key.startswith("test_")]:
            faulthandler.dump_traceback_later(LONGEST_S, exit=True, file=sys.stderr)
            began = time.monotonic()
            problem = ""
            try:
                getattr(module, test)()
            except BaseException:  # whatever it is, the host shall read it
                problem = traceback.format_exc()
            result = {"name": f"{name}.{test}", "problem": problem, "seconds": round(time.monotonic() - began, 2)}
            report(result)
    report({"name": "end"})


if __name__ == "__main__":
    main()
