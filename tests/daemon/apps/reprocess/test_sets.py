"""Sets of several images are assembled before the division: their clouds are those of a replay for every chunk size."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest
import yaml

from daemon.live.items import Pair
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame
from pipeline.common.settings import Settings
from sim.rig import rig_files
from tests.daemon.apps.reprocess.takes import files_of, replayed, reprocess
from tests.pipeline.multi_frame import sets

SETS, MISSING = 4, 1
"""Complete sets, and one in between without its second pair."""


@functools.cache
def images(mode: str) -> tuple[list[object], list[object]]:
    """Left and right images of one set."""
    return sets.taken(mode)


def write(path: Path, mode: str) -> Path:
    lefts, rights = images(mode)
    frames, first = len(lefts), 100
    calibration = yaml.safe_dump(rig_files.calibration_mapping(sets.LAYOUT, sets.OPTICS), sort_keys=False).encode()
    writer = TakeWriter(
        path, session="sets", device="sim", calibration_data=calibration, pattern=sets.sequence(mode).as_mapping(),
        volume=rig_files.volume_mapping(sets.LAYOUT), min_free_bytes=0, queue=200,
        extra_metadata={"first_pattern_sequence": str(first)},
    )  # fmt: skip
    for number in range((SETS + MISSING) * frames):
        if number == 2 * frames + 1:
            continue
        t_ns = 1_790_000_000_000_000_000 + 10_000_000 * number
        left, right = (
            Frame(side, first + number, t_ns, t_ns + 1_000_000, "rgb8", side_images[number % frames])
            for side, side_images in (("left", lefts), ("right", rights))
        )
        assert writer.offer(Pair(left, right))
    writer.close()
    return path


@pytest.mark.slow
@pytest.mark.parametrize("mode", [pytest.param("two_color", marks=pytest.mark.long), "gray"])
def test_sets_are_those_of_a_replay(tmp_path: Path, mode: str) -> None:
    take, settings = write(tmp_path / "a.mcap", mode), Settings(cluster_min_area=20)
    files, verdicts = replayed(take, settings=settings)
    assert len(files) == len(verdicts) == SETS
    parts = ("xyz", "rgb", "normals")
    reprocess([take], tmp_path / "parts", settings=settings, chunk_pairs=5, parts=parts)
    assert files_of(tmp_path / "parts" / "a") == replayed(take, parts=parts, settings=settings)[0]
    for chunk_pairs in (1, 5, 100):
        out = tmp_path / str(chunk_pairs)
        totals = reprocess([take], out, settings=settings, chunk_pairs=chunk_pairs)
        assert not totals.failures
        assert files_of(out / "a") == files
        assert (totals.closed[0].items, totals.closed[0].incomplete) == (SETS, MISSING)
        chunks = len(list((out / "a" / "chunks").iterdir()))
        assert chunks == 1 if chunk_pairs == 100 else chunks > 1
        assert totals.sums.points > 1000 * SETS
