"""A loop that is rendered while it is shown: the same images, and nothing left behind."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import DriverError
from sim.devices import rendered_loop as loops
from sim.devices.growing_loop import GrowingLoop, plain_values, shown
from sim.devices.open_rig import open_rig
from sim.devices.options import OptionError, SimOptions, from_mapping
from sim.rig.disturbance import Disturbance
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from tools.waiting import wait_until


@pytest.fixture
def options(tmp_path: Path) -> SimOptions:
    layout = RigLayout().scaled(0.0625)
    return SimOptions(frames=3, layout=layout, cache_dir=tmp_path / "cache", background=True)


def names(options: SimOptions) -> list[str]:
    assert options.cache_dir is not None
    return [path.name[:5] for path in options.cache_dir.iterdir()]


@pytest.mark.parametrize(
    "encoding", ["rgb8", *(pytest.param(name, marks=pytest.mark.long) for name in ("bayer_rggb8", "mono16"))]
)
def test_every_trigger_shows_an_image_of_the_rendered_loop(options: SimOptions, encoding: str) -> None:
    options = replace(options, encoding=encoding)
    expected = loops.render_loop(options)
    growing = GrowingLoop(options)
    try:
        for trigger in range(1000):
            before, pair, after = growing.ready, growing.pair(trigger), growing.ready
            possible = [expected.pair(shown(trigger, ready, 3)) for ready in range(before, after + 1)]
            assert any(all(np.array_equal(a, b) for a, b in zip(pair, each, strict=True)) for each in possible)
            assert not any(image.flags.writeable for image in pair)
        wait_until(lambda: names(options) == ["loop-"])
        for trigger in range(7):
            for image, same in zip(growing.pair(trigger), expected.pair(trigger), strict=True):
                assert np.array_equal(image, same)
    finally:
        growing.close()
    kept = loops.read(loops.folder_of(options))
    assert kept is not None and np.array_equal(kept.left, expected.left) and np.array_equal(kept.right, expected.right)


@pytest.mark.parametrize("frames", [1, 2, 3, 12])
def test_rendered_images_go_forth_and_back_and_at_the_end_round(frames: int) -> None:
    for ready in range(1, frames):
        sequence = [shown(trigger, ready, frames) for trigger in range(4 * frames)]
        assert set(sequence) == set(range(ready))
        assert all(abs(b - a) == (ready > 1) for a, b in itertools.pairwise(sequence))
    assert [shown(trigger, frames, frames) for trigger in range(2 * frames)] == [*range(frames)] * 2


def test_the_process_renders_what_the_options_name(options: SimOptions, tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text("v 0 0 0\n")
    for other in (
        options,
        replace(options, optics=Optics.realistic(), seed=3),
        replace(options, layout=replace(RigLayout(), baseline_mm=400.1), encoding="bayer_rggb8"),
        replace(options, scene="board", board="circles:11x9:32:20", poses=4),
        replace(options, scene="mesh", mesh=tmp_path / "part.obj"),
    ):
        assert loops.folder_of(from_mapping(plain_values(other))) == loops.folder_of(other)


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A loop of 1000 images that was ended after three or more of them."""
    cache = tmp_path_factory.mktemp("ended")
    options = SimOptions(frames=1000, layout=RigLayout().scaled(0.0625), cache_dir=cache, background=True)
    growing = GrowingLoop(options)
    wait_until(lambda: growing.ready >= 3)
    growing.close()
    (folder,) = cache.iterdir()
    assert folder.name == f"{loops.folder_of(options).name}-unfinished"
    return folder


@pytest.fixture(scope="module")
def expected_pairs() -> list[tuple[loops.Image, loops.Image]]:
    """The first images of that loop, rendered one after the other."""
    options = SimOptions(frames=1000, layout=RigLayout().scaled(0.0625), background=True)
    return list(itertools.islice(loops.rendered_pairs(options), 4))


def unfinished(options: SimOptions, ended: Path) -> Path:
    """A copy of the ended loop, where one with these options finds it."""
    assert options.cache_dir is not None
    return shutil.copytree(ended, options.cache_dir / ended.name)


def test_an_unfinished_loop_goes_on_where_it_ended(options: SimOptions, ended: Path) -> None:
    options = replace(options, frames=1000)
    folder = unfinished(options, ended)
    kept = int.from_bytes((folder / "ready").read_bytes(), sys.byteorder)
    growing = GrowingLoop(options)
    try:
        assert growing.ready >= kept >= 3
        assert [path for path in names(options) if path == "loop-"] == []
        wait_until(lambda: growing.ready >= kept + 2)
        found = [growing.pair(index) for index in range(kept + 2)]
    finally:
        growing.close()
    for pair, (left, right) in zip(found, loops.rendered_pairs(options), strict=False):
        assert np.array_equal(pair[0], left) and np.array_equal(pair[1], right)


@pytest.mark.parametrize(
    "damage",
    [
        "image",
        "other shape",
        *(pytest.param(k, marks=pytest.mark.long) for k in ("first image", "number", "short", "sums")),
    ],
)
def test_damaged_images_of_an_unfinished_loop_are_rendered_again(
    options: SimOptions, damage: str, ended: Path, expected_pairs: list[tuple[loops.Image, loops.Image]]
) -> None:
    options = replace(options, frames=1000)
    folder = unfinished(options, ended)
    left = folder / "left.npy"
    if "image" in damage:
        images = np.lib.format.open_memmap(left, "r+")
        images[0 if damage == "first image" else 2, 5, 5] ^= 1
        images.flush()
    elif damage == "short":
        left.write_bytes(left.read_bytes()[:100])
    elif damage == "sums":
        (folder / "sums.npy").write_bytes(b"no sums")
    elif damage == "number":
        (folder / "ready").write_bytes((65535).to_bytes(2, sys.byteorder))
    else:
        np.save(left, np.zeros((4, 5, 6), np.uint8))
    growing = GrowingLoop(options)
    try:
        wait_until(lambda: growing.ready >= 4)
        for index, (one, other) in enumerate(expected_pairs):
            found = growing.pair(index)
            assert np.array_equal(found[0], one) and np.array_equal(found[1], other)
    finally:
        growing.close()


def test_the_process_ends_with_the_one_that_started_it(options: SimOptions) -> None:
    code = """
import json, os, sys
from sim.devices.growing_loop import GrowingLoop
from sim.devices.options import from_mapping
GrowingLoop(from_mapping(json.loads(sys.argv[1])))
os._exit(0)
"""
    command = [sys.executable, "-c", code, json.dumps(plain_values(replace(options, frames=1000)))]
    subprocess.run(command, check=True, timeout=60)
    kept = f"{loops.folder_of(replace(options, frames=1000)).name}-unfinished"
    wait_until(lambda: [path.name for path in (options.cache_dir or Path()).iterdir()] == [kept])


def test_a_scene_that_cannot_be_rendered_is_an_error(options: SimOptions, tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text("no mesh")
    with pytest.raises(DriverError, match=r"^the process that renders the simulated rig ended: .*part\.obj"):
        GrowingLoop(replace(options, scene="mesh", mesh=tmp_path / "part.obj"))
    assert names(options) == []
    with pytest.raises(ValueError, match=r"^mesh .*part\.obj"):
        open_rig(replace(options, scene="mesh", mesh=tmp_path / "part.obj"))


def test_a_rig_ends_its_rendering_and_does_without_where_the_loop_is_cached(options: SimOptions) -> None:
    calls: list[tuple[int, int]] = []
    rig = open_rig(options, progress=lambda *done: calls.append(done))
    try:
        assert rig.growing is not None and rig.growing.ready
        assert set(calls) == {(0, 1), (1, 1)} and calls[-1] == (1, 1)
        wait_until(lambda: names(options) == ["loop-"])
    finally:
        rig.close()
    again = open_rig(options)
    again.close()
    assert again.growing is None


def test_a_place_that_is_a_file_costs_only_time(options: SimOptions) -> None:
    assert options.cache_dir is not None
    options.cache_dir.write_text("not a folder")
    rig = open_rig(options)
    rig.close()
    assert rig.growing is None


@pytest.mark.parametrize(
    "change", [{"live": True}, {"rate_hz": 0.0}, {"disturb": (Disturbance("left", at=1, shift_px=(1.0, 0.0)),)}]
)
def test_what_depends_on_the_trigger_alone_is_rendered_before(options: SimOptions, change: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=r"^sim\.background is true"):
        replace(options, **change)
