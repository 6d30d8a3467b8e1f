"""Metric clouds, live or recorded: `python examples/01_clouds.py [PLACE] [CLOUDS]`.

PLACE is a take (`take.mcap`), a folder of clouds, or the control address of a daemon; without one, the daemon of this
machine (start one with `fringed demo` or `fringed run examples/rig.yaml`). Stops after CLOUDS clouds (default: never).
"""

from __future__ import annotations

import sys

import numpy as np

import fringed

most = int(sys.argv[2]) if len(sys.argv) > 2 else None

with fringed.open(sys.argv[1]) if len(sys.argv) > 1 else fringed.Rig() as rig, rig.clouds() as clouds:
    for cloud in clouds:
        points = cloud.points  # (N, 3) float32, millimetres, left camera's frame
        depth = f"median depth {np.median(points[:, 2]):.2f} mm" if len(points) else "no surface"
        print(f"cloud {cloud.header.seq}: {len(points)} points, {depth}, lost so far {clouds.lost}", flush=True)
        if clouds.received == most:
            break
