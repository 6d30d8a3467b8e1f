"""The committed take of the simulated rig replays to its committed figures; a stranger's reader reads it too."""

import json

from daemon.cli import entry
from tests.daemon.recording.independent_reader import read
from tests.golden.make import FIGURES, TAKE


def test_the_golden_take_replays_to_its_figures(tmp_path, fringed):
    done = fringed(
        "replay",
        str(TAKE),
        "--no-output",
        "--out",
        str(tmp_path),
        "--expect",
        str(FIGURES),
        "--set",
        "cluster_min_area=60",
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_figures_that_moved_are_reported_and_fail(tmp_path, capsys):
    status = entry.run([
        "replay", str(TAKE), "--no-output", "--out", str(tmp_path), "--expect", str(FIGURES),
        "--set", "cluster_min_area=60", "--set", "min_modulation=40",
    ])  # fmt: skip
    assert status == 1
    assert "points" in "".join(capsys.readouterr())


def test_a_reader_without_our_code_reads_the_golden_take():
    take = read(TAKE)
    assert len(take["frames"]) == 4
    assert {(f[0], f[1]) for f in take["frames"]} == {
        (f"/{side}/image", n) for side in ("left", "right") for n in (0, 1)
    }
    assert all(f[5].shape == (308, 384, 3) for f in take["frames"])
    assert json.loads(take["attachments"]["pattern.json"][1])["kind"] == "color_fringe"
    assert take["metadata"]["fringed"]["version"] == "1"
