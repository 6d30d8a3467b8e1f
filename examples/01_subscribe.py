"""Receive metric clouds from a running daemon: `python examples/01_subscribe.py [ENDPOINT] [CLOUDS]`.

Start one first: `fringed demo` or `fringed run examples/rig.yaml`. Stops after CLOUDS clouds (default: never).
"""

from __future__ import annotations

import sys

import numpy as np

from fringed import subscribe

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555"
clouds = int(sys.argv[2]) if len(sys.argv) > 2 else None

with subscribe(endpoint, timeout_s=30) as stream:
    for cloud in stream:
        points = cloud.points  # (N, 3) float32, millimetres, left camera's frame
        depth = f"median depth {np.median(points[:, 2]):.2f} mm" if len(points) else "nothing seen"
        print(f"cloud {cloud.header.seq}: {len(points)} points, {depth}, lost so far {stream.lost}", flush=True)
        if stream.received == clouds:
            break
