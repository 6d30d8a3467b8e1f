"""Multi-frame modes through the whole daemon on the small rendered rig: right clouds, marked motion, same replays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.apps.export.cloud_files import read_cloud
from daemon.apps.replay.take_items import Sets
from daemon.bootstrap.sinks import open_take
from daemon.cli.entry import run
from daemon.live.publishing import messages
from daemon.recording.read.take_reader import TakeReader
from daemon.recording.recorder import Recorder
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from sim.evaluate.score import score
from sim.render.render_pair import truths
from sim.rig.layout import RigLayout
from sim.scene import named_scenes
from tests.daemon.live.projection.mode_rigs import rendered
from tools.waiting import wait_until

LAYOUT = RigLayout().scaled(0.125)
SPHERES = "scene: spheres"


def test_clouds_are_right_and_a_replay_of_the_take_gives_the_same_bit_for_bit(tmp_path: Path) -> None:
    with rendered(tmp_path, simulation=SPHERES) as running:
        service = running.service
        rig_file = tmp_path / "rig.yaml"
        rig_file.write_text("no matter")
        recorder = Recorder(
            service.router,
            service.config,
            tmp_path / "takes",
            lambda take: open_take(
                running.config,
                service.rig,
                "s",
                take,
                rig_file,
                serials=service.path.serials,
                shown=service.mode_controller.shown,
            ),
            clock=service.clock,
        )
        take = Path(str(recorder.start("sets")["file"]))
        newest = max((item.left.trigger for item in running.sink.pairs), default=-1)
        wait_until(lambda: sum(item.seq > newest for item in running.sink.clouds) >= 3, 90)
        assert recorder.stop()["pairs"] >= 24
        status = service.status()
        assert status.mode == "heterodyne" and status.sequence["frames"] == 12 and status.sequence["sets"] >= 3
        clouds = {item.seq: item for item in running.sink.clouds}
    truth = truths(LAYOUT, named_scenes.build("spheres"), LAYOUT.pattern())[0]
    for item in clouds.values():
        assert item.frames == 12 and item.span_ms > 0 and item.latency_ms >= item.span_ms and item.seq % 12 == 0
        found = score(item.cloud.xyz, truth)
        assert found.reconstructed > 0.85 and found.wrong < 0.01, found
    stats = messages._cloud_header(messages.Origin("d", "s", "c"), item, item.cloud).stats
    assert {key: stats[key] for key in ("mode", "frames")} == {"mode": "heterodyne", "frames": 12}
    assert set(stats) >= {"span_ms", "moved"}
    out = tmp_path / "out"
    assert run(["replay", str(take), "--out", str(out), "--set", "self_calibrate=false"]) == 0
    same = [seq for seq in clouds if (out / f"cloud_{seq:06d}.npz").exists()]
    assert len(same) >= 2
    for seq in same:
        np.testing.assert_array_equal(read_cloud(out / f"cloud_{seq:06d}.npz").xyz, clouds[seq].cloud.xyz)
    assert run(["info", str(take)]) == 0
    with TakeReader(take) as reader:
        assert reader.whole and reader.first_pattern_sequence == 0
        _no_points_in_a_wrong_order(reader)


def _no_points_in_a_wrong_order(take: TakeReader) -> None:
    """Images that begin with another one than was thought give nothing, rather than something wrong."""
    sequence = take.sequence()
    assert sequence is not None
    made = SetReconstructor(take.calibration().calibration, sequence, take.volume(), encoding="rgb8")
    item = next(Sets(take, sequence).items())
    for turn in (1, 4, 6):
        lefts, rights = (side[turn:] + side[:turn] for side in (item.lefts, item.rights))
        assert made.reconstruct(lefts, rights).points < 50


def test_what_moves_during_a_set_is_marked_and_the_rest_is_measured(tmp_path: Path) -> None:
    with rendered(tmp_path, simulation="scene: moving, frames: 11") as running:
        wait_until(lambda: any(item.moved > 100 for item in running.sink.clouds), 90)
        item = next(item for item in running.sink.clouds if item.moved > 100)
    assert item.cloud.points > 2000, "the board behind what moves is at rest"


@pytest.mark.parametrize("lost", ["left", "right"])
def test_stored_images_are_identified_by_the_trigger_and_a_lost_frame_costs_only_its_set(
    tmp_path: Path, lost: str
) -> None:
    faults = f"faults: {{script: [{{kind: lost, at: 41, side: {lost}}}, {{kind: lost, at: 55, side: {lost}}}]}}"
    sequence = "{display: stored, first_trigger: 5}"
    with rendered(tmp_path, sequence=sequence, simulation=f"{SPHERES}, {faults}") as running:
        wait_until(lambda: any(item.seq > 64 for item in running.sink.clouds), 90)
        clouds = list(running.sink.clouds)
        status = running.service.status()
    assert all(item.seq % 12 == 5 and item.cloud.points > 5000 for item in clouds)
    assert not {41, 53} & {item.seq for item in clouds}, "the sets that missed an image"
    assert status.sequence["sets_incomplete"] >= 2 and status.reasons == ()
