"""The cloud that a subscriber gets of the box errs as much as one of images that never left the simulator."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest

from benchmarks.common.box_daemon import Daemon
from fringed import subscribe
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.box.box import Box
from sim.evaluate.score import Score, score
from sim.render import render_pair
from tools.waiting import wait_until

PAIRS = 3


def simulated(box: Box, index: int) -> np.ndarray:
    """The cloud of the same scene and noise, rendered and reconstructed in memory."""
    options, layout = box.options.simulation, box.options.layout
    pattern = layout.pattern()
    pair = render_pair.render_pair(layout, box.stage.scene, pattern, options.optics, 0.0, index, options.encoding)
    made = Reconstructor(layout.calibration_for(options.optics), pattern, layout.volume(), encoding=options.encoding)
    return made.reconstruct(pair.left, pair.right).xyz


def line(name: str, scored: Score) -> str:
    return (
        f"{name:10} {scored.points:7} points  {scored.reconstructed:7.2%} right  {scored.wrong:7.3%} wrong  "
        f"rms {scored.rms_mm:.4f} mm  smooth {scored.smooth_rms_mm:.4f} mm"
    )


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["rgb8", pytest.param("bayer_rggb8", marks=pytest.mark.long)])
def test_the_loop_costs_no_accuracy(make_box: Callable[..., Box], encoding: str) -> None:
    box = make_box(encoding=encoding)
    truth, _ = render_pair.truths(box.options.layout, box.stage.scene, box.options.layout.pattern())
    with Daemon(box) as daemon, closing(subscribe(daemon.stream, latest=False, timeout_s=30)) as clouds:
        wait_until(
            lambda: "cloud/full" in daemon.service.router.sinks["stream"].status()["topics"], 30, "the subscription"
        )
        received = []
        for _ in range(PAIRS):
            index = daemon.step_until_pair()
            wait_until(lambda index=index: daemon.pair_check.last_cloud == index, 30, "the cloud")
            # Clouds before the last one may have been overtaken, as they should where the reader or the PC is slow.
            while not received or received[-1].header.seq != daemon.service.worker.last.seq:
                received.append(next(clouds))
    assert len(received) >= PAIRS
    looped, pure = score(received[-1].xyz, truth), score(simulated(box, index), truth)
    title = f"\n{encoding}, {box.options.layout.camera_size[0]} x {box.options.layout.camera_size[1]}, scene mixed"
    print(title, line("loop", looped), line("simulated", pure), sep="\n")  # noqa: T201 - the table is the result
    assert daemon.pair_check.counts["wrong"] == daemon.pair_check.counts["unknown"] == 0
    assert looped.reconstructed == pytest.approx(pure.reconstructed, abs=0.002)
    assert looped.wrong == pytest.approx(pure.wrong, abs=0.001)
    assert looped.rms_mm == pytest.approx(pure.rms_mm, rel=0.02)
    assert looped.smooth_rms_mm == pytest.approx(pure.smooth_rms_mm, rel=0.05)
