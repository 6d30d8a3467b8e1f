"""Operate a rig from a program: `python examples/04_operate_a_rig.py [ADDRESS] [KEY SERVER_KEY]`.

Reads the status, changes a setting for one take of two seconds, and writes a snapshot.
"""

from __future__ import annotations

import sys
import time

import fringed

address = sys.argv[1] if len(sys.argv) > 1 else None
key, server_key = sys.argv[2:4] if len(sys.argv) > 3 else (None, None)

with fringed.Rig(address, key=key, server_key=server_key) as rig:
    status, health = rig.status(), rig.health()
    print(f"{status.device}: {status.state}, {status.cloud_rate_hz} clouds per second, health {health.verdict}")

    before = rig.get("recording.sync")
    try:
        rig.set("recording.sync", "none")
        with rig.record("example") as take:
            time.sleep(2)
        print(f"{take.file}: {take.stop().pairs} pairs")
    finally:
        rig.set("recording.sync", before)

    snapshot = rig.snapshot("example")
    print(f"{snapshot.file}: {snapshot.points} points")
