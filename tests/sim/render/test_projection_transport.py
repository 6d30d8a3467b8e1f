"""Relighting agrees with the renderer for any image, scene, encoding and optics, and is linear in the light."""

from __future__ import annotations

import numpy as np
import pytest

from sim.render import projection_transport, render_pair
from sim.render.projection_transport import Stage
from sim.rig.disturbance import Disturbance, TrueRig
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene import named_scenes

SMALL = RigLayout().scaled(0.0625)
CASES = {
    "standard": ("mixed", Optics(), "rgb8", 0.0),
    "every fault": ("steps", Optics.realistic(), "bayer_rggb8", 0.0),
    "moving": ("moving", Optics(exposure_us=20_000), "bayer_gbrg8", 0.7),
    "ideal": ("spheres", Optics.ideal(supersampling=1), "rgb8", 0.0),
    "mono": ("face", Optics(supersampling=3), "mono16", 0.0),
}


def images() -> dict[str, np.ndarray]:
    width, height = SMALL.projector_size
    noise = np.random.default_rng(4).integers(0, 256, (height, width, 3), dtype=np.uint8)
    edges = np.zeros_like(noise)
    edges[[0, -1]] = edges[:, [0, -1]] = 255
    return {"fringes": SMALL.pattern().image(), "noise": noise, "edges": edges, "black": np.zeros_like(noise)}


@pytest.mark.parametrize("case", CASES)
def test_any_projected_image_matches_the_renderer(case: str) -> None:
    name, optics, encoding, t_s = CASES[case]
    scene = named_scenes.build(name, seed=2)
    stage = Stage(SMALL, scene, optics, encoding=encoding, instants_s=(t_s,))
    for image in images().values():
        expected = render_pair.render_counts(SMALL, scene, image, optics, t_s, encoding)
        for lit, rendered in zip(stage.counts(image), expected, strict=True):
            assert lit.dtype == np.float32 and lit.shape == rendered.shape
            assert np.abs(lit - rendered).max() < 2e-3
        noisy = render_pair.with_noise(expected, optics, 9, encoding)
        for made, wanted in zip(stage.images(stage.counts(image), 9), noisy, strict=True):
            assert np.abs(made.astype(np.int64) - wanted).max() <= 1
            assert np.mean(made != wanted) < 1e-3 if made.dtype == np.uint8 else True


def test_light_adds_up() -> None:
    optics = Optics()
    stage = Stage(SMALL, named_scenes.build("mixed"), optics)
    rng = np.random.default_rng(1)
    one, other = (rng.integers(0, 128, images()["noise"].shape, dtype=np.uint8) for _ in range(2))
    dark, first, second, both = (stage.counts(p)[0] for p in (np.zeros_like(one), one, other, one + other))
    assert np.abs((both - dark) - (first - dark) - (second - dark)).max() < 2e-3


def test_the_noise_depends_on_the_seed_alone() -> None:
    stage = Stage(SMALL, named_scenes.build("plane"))
    counts = stage.counts(images()["fringes"])
    first, again, other = (stage.images(counts, seed)[1] for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_instants_go_round_and_a_scene_at_rest_needs_one() -> None:
    times = (0.0, 1.0, 2.0)
    moving, still = (Stage(SMALL, named_scenes.build(name), instants_s=times) for name in ("moving", "plane"))
    assert (moving.instants_s, still.instants_s) == (times, (0.0,))
    white = np.full_like(images()["black"], 255)
    pics = [moving.counts(white, instant)[0] for instant in range(4)]
    assert np.array_equal(pics[0], pics[3])
    assert not np.array_equal(pics[0], pics[1])


@pytest.mark.parametrize(
    ("change", "traced"),
    [
        (Disturbance("right", turn_deg=(0.0, 0.1, 0.0)), 1),
        (Disturbance("left", shift_px=(0.0, 0.4)), 1),
        (Disturbance("left", crosstalk=0.1), 0),
        (Disturbance("projector", shift_px=(1.0, 0.0)), 2),
    ],
    ids=str,
)
def test_a_stage_like_another_traces_only_cameras_whose_view_of_the_light_has_changed(
    change: Disturbance, traced: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, image = named_scenes.build("plane"), images()["noise"]
    rig = TrueRig.of(SMALL, Optics()).after(change)
    before, expected = Stage(SMALL, scene), Stage(SMALL, scene, rig=rig).counts(image)
    trace = projection_transport._footprint
    calls: list[object] = []
    monkeypatch.setattr(projection_transport, "_footprint", lambda *of: calls.append(of) or trace(*of))
    stage = Stage(SMALL, scene, rig=rig, like=before)
    assert len(calls) == traced
    assert all(np.array_equal(*both) for both in zip(stage.counts(image), expected, strict=True))
    assert not all(np.array_equal(*both) for both in zip(before.counts(image), expected, strict=True))


def test_invalid_arguments_raise_an_error() -> None:
    with pytest.raises(ValueError, match="encoding is 'yuv', expected one of rgb8"):
        Stage(SMALL, named_scenes.build("plane"), encoding="yuv")
    with pytest.raises(ValueError, match="instants_s is empty"):
        Stage(SMALL, named_scenes.build("plane"), instants_s=())
    with pytest.raises(ValueError, match=r"the projected image is \(4, 4, 3\)"):
        Stage(SMALL, named_scenes.build("plane")).counts(np.zeros((4, 4, 3), np.uint8))
