"""Loops of images: rendered once, kept whole, and rendered again when what was kept is spoiled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.devices import rendered_loop as loops
from sim.devices.options import OptionError, SimOptions, from_mapping
from sim.rig.layout import RigLayout


@pytest.fixture
def options(tmp_path):
    layout = RigLayout().scaled(0.0625)
    return SimOptions(scene="moving", frames=3, layout=layout, cache_dir=tmp_path / "cache")


def rendered(options):
    """The loop, and how many images had to be rendered for it."""
    calls = []
    found = loops.load_or_render(options, lambda done, of: calls.append((done, of)))
    return found, max(0, len(calls) - 1)


def test_a_loop_is_rendered_once_and_read_back_bit_by_bit(options):
    first, work = rendered(options)
    again, no_work = rendered(options)
    assert (work, no_work) == (3, 0)
    assert np.array_equal(first.left, again.left)
    assert np.array_equal(first.right, again.right)
    fresh = loops.render_loop(options)
    assert np.array_equal(fresh.left, first.left)


def test_progress_counts_from_nothing_to_all(options):
    calls = []
    loops.load_or_render(options, lambda done, of: calls.append((done, of)))
    assert calls == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_pairs_go_round_and_cannot_be_written(options):
    loop, _ = rendered(options)
    assert len(loop) == 3
    assert np.array_equal(loop.pair(4)[0], loop.pair(1)[0])
    assert not np.array_equal(loop.pair(0)[0], loop.pair(1)[0])
    for image in loop.pair(0):
        assert type(image) is np.ndarray
        assert not image.flags.writeable


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        ("cut", "left.npy"),
        ("flip", "right.npy"),
        ("flip", "loop.json"),
        ("remove", "loop.json"),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (
                ("flip", "left.npy"),
                ("remove", "left.npy"),
                ("cut", "right.npy"),
                ("remove", "right.npy"),
                ("cut", "loop.json"),
            )
        ),
    ],
)
def test_a_spoiled_cache_is_rendered_again(spoil, name, options):
    first, _ = rendered(options)
    expected = np.array(first.left)
    (folder,) = options.cache_dir.glob("loop-*")
    data = bytearray((folder / name).read_bytes())
    del first
    (folder / name).unlink()
    if spoil != "remove":
        data[len(data) // 2] ^= 0xFF
        (folder / name).write_bytes(data if spoil == "flip" else data[: len(data) // 2])
    again, work = rendered(options)
    assert work == 3
    assert np.array_equal(again.left, expected)
    assert rendered(options)[1] == 0


def test_no_partial_loop_is_left_behind(options):
    rendered(options)
    assert [path.name[:5] for path in options.cache_dir.iterdir()] == ["loop-"]


def test_a_cache_in_a_place_that_is_a_file_costs_only_time(options):
    options.cache_dir.write_text("not a folder")
    assert len(rendered(options)[0]) == 3


def test_every_option_that_changes_images_changes_the_digest(options):
    others = [
        replace(options, scene="plane"),
        replace(options, seed=1),
        replace(options, frames=4),
        replace(options, encoding="bayer_rggb8"),
        replace(options, layout=replace(options.layout, baseline_mm=400.0)),
        replace(options, optics=replace(options.optics, ambient=0.3)),
    ]
    digests = {loops.digest(item) for item in (options, *others)}
    assert len(digests) == 7
    assert loops.digest(replace(options, rate_hz=3.0)) == loops.digest(options)


def test_the_images_of_a_scene_at_rest_differ_by_noise_only(options):
    loop = loops.render_loop(replace(options, scene="plane"))
    difference = loop.left[0].astype(float) - loop.left[1]
    assert 0.5 < difference.std() < 4
    assert abs(difference.mean()) < 0.1


def test_the_default_cache_is_the_users(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert loops.default_cache_dir() == tmp_path / "fringed"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert loops.default_cache_dir() == tmp_path / "home" / ".cache" / "fringed"


def test_plain_values_become_checked_options(tmp_path):
    options = from_mapping(
        {
            "scene": "mixed",
            "layout": {"projector_fraction": 0.5, "scale": 0.25},
            "optics": {"preset": "realistic", "defocus_px": 2.0, "color_shift_px": [0.1, 0, 0]},
            "faults": {"lost": 0.1, "extra_first": "left", "script": [{"kind": "gone", "at": 5, "side": "right"}]},
            "cache_dir": "here",
        },
        tmp_path,
    )
    assert options.layout.camera_size == (256, 205)
    assert options.layout.projector_fraction == 0.5
    assert (options.optics.gamma, options.optics.defocus_px) == (2.2, 2.0)
    assert options.optics.color_shift_px == (0.1, 0, 0)
    assert options.cache_dir == tmp_path / "here"
    assert options.faults.gone(5, "right")
    assert options.faults.extra_first("left")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"scen": "mixed"}, r"sim\.scen is not an option; did you mean 'scene'"),
        ({"scene": "moon"}, r"sim\.scene is 'moon', expected one of plane"),
        ({"scene": "mesh"}, r"sim\.mesh is None"),
        ({"frames": 0}, r"sim\.frames is 0, expected 1 to 1000"),
        ({"frames": "many"}, r"sim\.frames is 'many', expected int"),
        ({"seed": -1}, r"sim\.seed is -1"),
        ({"rate_hz": 1e9}, r"sim\.rate_hz"),
        ({"encoding": "jpeg"}, r"sim\.encoding is 'jpeg'"),
        ({"layout": {"baseline": 3}}, r"sim\.layout\.baseline is not an option; did you mean 'baseline_mm'"),
        ({"layout": {"baseline_mm": -3}}, r"sim\.layout: layout\.baseline_mm is -3"),
        ({"layout": {"baseline_mm": "wide"}}, r"sim\.layout"),
        ({"layout": {"scale": 0}}, r"sim\.layout\.scale is 0"),
        ({"layout": 3}, r"sim\.layout is 3, expected a mapping"),
        ({"optics": {"gama": 2}}, r"did you mean 'gamma'"),
        ({"optics": {"preset": "nice"}}, r"sim\.optics\.preset is 'nice'"),
        ({"optics": {"supersampling": 99}}, r"optics\.supersampling is 99, expected 1 to 8"),
        ({"faults": {"lost": 2}}, r"faults\.lost is 2"),
        ({"faults": {"script": [{"kind": "flood"}]}}, r"sim\.faults\.script\[0\]\.kind is 'flood'"),
        ({"faults": {"extra_first": "middle"}}, r"sim\.faults\.extra_first is 'middle'"),
    ],
)
def test_wrong_options_are_named(data, message):
    with pytest.raises(OptionError, match=message):
        from_mapping(data)


def test_a_written_pair_holds_images_and_truth(tmp_path, small):
    import cv2

    from sim.evaluate.write_pair import write_pair
    from sim.render import render_pair
    from sim.scene import named_scenes

    pair = render_pair.render_pair(small, named_scenes.build("face"), small.pattern())
    write_pair(pair, tmp_path)
    assert np.array_equal(cv2.imread(str(tmp_path / "left.png"))[..., ::-1], pair.left)
    with np.load(tmp_path / "truth_right.npz", allow_pickle=False) as truth:
        assert set(truth) == {"xyz", "projector", "order", "lit", "seen_by_both"}
        assert np.array_equal(truth["lit"], pair.truth_right.lit)
