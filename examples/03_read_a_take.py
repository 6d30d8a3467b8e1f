"""Reconstruct a recorded take with other settings: `python examples/03_read_a_take.py TAKE.mcap [SETTING VALUE]`.

Prints what the take carries and how many points each pair gives; SETTING is for example
pipeline.settings.min_modulation.
"""

from __future__ import annotations

import json
import sys

import fringed

with fringed.open(sys.argv[1]) as take:
    hello, status = take.hello(), take.status()
    print(f"{hello.device}, session {hello.session}, mode {status.mode}, calibration {status.calibration}")
    if len(sys.argv) > 3:
        print(f"{sys.argv[2]} = {take.set(sys.argv[2], json.loads(sys.argv[3]))}")
    for cloud in take.clouds():
        sigma_mm = float(cloud.sigma[cloud.valid].mean()) if cloud.sigma is not None and cloud.valid.any() else 0.0
        print(f"pair {cloud.header.seq}: {len(cloud.points)} points, mean standard deviation {sigma_mm:.3f} mm")
