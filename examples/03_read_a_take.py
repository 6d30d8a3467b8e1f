"""Read a recorded take in Python: `python examples/03_read_a_take.py TAKE.mcap`.

Prints what the take carries, then the brightness of both images of every pair, and how many points it gives.
A take that was cut off or damaged is read up to the damage; its problems are printed at the end.
"""

from __future__ import annotations

import sys
from pathlib import Path

from daemon.apps.replay.runner import Replay
from daemon.recording.read.take_reader import TakeReader

with TakeReader(Path(sys.argv[1])) as take:
    calibration = take.calibration()
    print(f"session {take.metadata.get('session')}, calibration {calibration.identity}")
    print(f"baseline {calibration.calibration.baseline_mm:.1f} mm, {take.pattern().periods:g} fringe periods")

    for result in Replay(take).results():
        pair, cloud = result.pair, result.cloud
        brightness = f"left {pair.left.mean():.1f}, right {pair.right.mean():.1f} counts"
        print(f"pair {pair.sequence}: {pair.encoding} {pair.left.shape}, {brightness}, {cloud.points} points")

    unpaired, double = take.counts.unpaired.total(), take.counts.duplicates.total()
    print(f"{take.counts.pairs} pairs, {unpaired} frames without a partner, {double} double ones")
    for problem in take.problems:
        print(f"problem: {problem}")
