"""A live rig: images under the projected image, of a board at its pose, and of a disturbed rig."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.protocols import Camera, Projector
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig import calibration
from sim.devices.clock import SteppedClock
from sim.devices.open_rig import open_rig
from sim.devices.options import OptionError, from_mapping
from sim.devices.scene_options import optics_of, scene_of
from sim.render import render_pair
from sim.rig.disturbance import Disturbance, TrueRig

OPTIONS = {"scene": "spheres", "live": True, "layout": {"scale": 0.0625}, "rate_hz": 0, "optics": {"noise": 0.0}}
BOARD = {**OPTIONS, "scene": "board", "board": "circles:5x4:60:36", "poses": 3}


@pytest.fixture
def opened():
    """``opened(options)`` is a rig with all devices at work; it is closed in the end."""
    rigs = []

    def make(options, **settings):
        rig = open_rig(options, clock=SteppedClock(), **settings)
        rigs.append(rig)
        rig.projector.open()
        for camera in rig.cameras.values():
            camera.open()
            camera.start()
        return rig

    yield make
    for rig in rigs:
        rig.close()


def captured(rig, image=None):
    """Both images of one trigger under an image."""
    if image is not None:
        rig.projector.show(image)
    rig.trigger.step()
    return [rig.cameras[side].read(0.0).image for side in ("left", "right")]


def images_of(rig):
    """White, black, a fringe along each axis, and noise."""
    columns, rows = rig.options.layout.projector_size
    even = np.zeros((rows, columns, 3), np.uint8)
    fringes = [ColorFringe((columns, rows), 9.0, axis).image() for axis in ("x", "y")]
    random = np.random.default_rng(3).integers(0, 256, even.shape, dtype=np.uint8)
    return [even + np.uint8(180), even, *fringes, random]


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "mono16"])
def test_cameras_see_what_the_projector_shows(encoding, opened):
    rig = opened(
        {**OPTIONS, "encoding": encoding, "optics": {"noise": 0.0, "gamma": 2.2, "color_shift_px": [0.3, 0, 0]}}
    )
    options = rig.options
    for image in images_of(rig):
        expected = render_pair.render_images(
            options.layout, scene_of(options), image, options.optics, encoding=encoding
        )
        step = 257 if encoding == "mono16" else 1
        for ours, theirs in zip(captured(rig, image), expected, strict=True):
            assert ours.dtype == theirs.dtype
            assert ours.shape == theirs.shape
            assert np.abs(ours.astype(int) - theirs).max() <= step


def test_devices_of_a_live_rig_keep_their_protocols(opened):
    rig = opened(OPTIONS)
    assert isinstance(rig.projector, Projector)
    assert all(isinstance(camera, Camera) for camera in rig.cameras.values())
    with pytest.raises(SettingRefused, match="does not fit"):
        rig.projector.show(np.zeros((8, 8, 3), np.uint8))
    bright = captured(rig, images_of(rig)[0])[0].max()
    rig.projector.close()
    assert captured(rig)[0].max() < 0.2 * bright
    with pytest.raises(DriverError, match=r"show.. while closed"):
        rig.projector.show(images_of(rig)[0])
    assert rig.projector.problem() == ""


def test_an_unopened_projector_shows_the_pattern():
    rig = open_rig(OPTIONS, clock=SteppedClock())
    for camera in rig.cameras.values():
        camera.open()
        camera.start()
    pattern = rig.options.layout.pattern().image()
    expected = render_pair.render_images(rig.options.layout, scene_of(rig.options), pattern, rig.options.optics)
    assert np.abs(captured(rig)[0].astype(int) - expected[0]).max() <= 1
    rig.close()


def test_every_trigger_has_its_own_noise_of_the_right_variance(opened):
    rig = opened({**OPTIONS, "scene": "plane", "optics": {}, "seed": 5})
    gray = images_of(rig)[0]
    first, second = (np.stack(captured(rig, gray)).astype(float) for _ in range(2))
    counts = render_pair.render_counts(rig.options.layout, scene_of(rig.options), gray, rig.options.optics)
    from sim.render.sensor import noise_variance

    variance = np.stack([noise_variance(part, rig.options.optics) for part in counts])
    difference = second - first
    assert abs(difference.mean()) < 0.02
    # Each image is rounded to whole counts, which adds a twelfth.
    assert difference.var() == pytest.approx(2 * (variance.mean() + 1 / 12), rel=0.02)
    assert abs(np.corrcoef((first - np.stack(counts)).ravel(), difference.ravel())[0, 1] + np.sqrt(0.5)) < 0.02
    again = opened({**OPTIONS, "scene": "plane", "optics": {}, "seed": 5})
    assert np.array_equal(np.stack(captured(again, gray)), first)


def test_a_moving_scene_goes_round(opened):
    rig = opened({**OPTIONS, "scene": "moving", "frames": 3})
    white = images_of(rig)[0]
    frames = [captured(rig, white)[0] for _ in range(4)]
    assert np.array_equal(frames[0], frames[3])
    assert np.abs(frames[0].astype(int) - frames[1]).max() > 30
    scene = scene_of(rig.options)
    expected = render_pair.render_images(
        rig.options.layout, scene, white, rig.options.optics, t_s=2 * scene.period_s / 3
    )
    assert np.abs(frames[2].astype(int) - expected[0]).max() <= 2


def test_the_board_stays_until_it_is_moved_on_and_stays_at_the_last_pose(opened):
    rig = opened(BOARD)
    white = images_of(rig)[0]
    options, seen = rig.options, []
    for expected_pose in (0, 1, 2, 2):
        assert rig.trigger.pose == expected_pose
        pair, again = captured(rig, white), captured(rig)
        assert np.array_equal(pair[0], again[0])
        expected = render_pair.render_images(
            options.layout, scene_of(options, expected_pose), white, optics_of(options)
        )
        assert np.abs(pair[1].astype(int) - expected[1]).max() <= 1
        seen.append(pair[0])
        assert rig.trigger.next_pose() == min(expected_pose + 1, 2)
    assert np.array_equal(seen[2], seen[3])
    assert np.abs(seen[0].astype(int) - seen[1]).max() > 50
    assert rig.trigger.poses == 3


def test_a_loop_of_a_board_shows_its_first_pose(opened, tmp_path):
    loop = opened({**BOARD, "live": False, "frames": 1, "cache_dir": str(tmp_path)})
    live = opened(BOARD)
    image = live.options.layout.pattern().image()
    for ours, theirs in zip(captured(live, image), captured(loop, image), strict=True):
        assert np.abs(ours.astype(int) - theirs).max() <= 1
    notes = [rig.cameras["left"].note for rig in (live, loop)]
    assert "what the projector shows" in notes[0]
    assert "loop" in notes[1]


def test_a_board_may_move_on_by_itself(opened):
    rig = opened({**BOARD, "hold": 2})
    white = images_of(rig)[0]
    poses, frames = [], []
    for _ in range(7):
        poses.append(rig.trigger.pose)
        frames.append(captured(rig, white)[0])
    assert poses == [0, 0, 1, 1, 2, 2, 2]
    same = [np.array_equal(a, b) for a, b in pairwise(frames)]
    assert same == [True, False, True, False, True, True]


@pytest.mark.parametrize(
    ("side", "change"),
    [
        ("right", {"turn_deg": (0.2, -0.3, 0.5)}),
        ("left", {"turn_deg": (0.0, 0.3, 0.0)}),
        ("right", {"shift_px": (1.5, -0.5)}),
        ("left", {"crosstalk": 0.05}),
        ("projector", {"turn_deg": (0.0, 0.2, 0.0)}),
    ],
)
def test_a_disturbance_changes_its_own_parameters_only(side, change, opened):
    rig = opened(OPTIONS)
    image = images_of(rig)[2]
    before = captured(rig, image)
    calibration = rig.calibration
    rig.trigger.disturb(side, **change)
    after = captured(rig)
    options = rig.options
    true = TrueRig.of(options.layout, options.optics).after(Disturbance(side, **change))
    expected = render_pair.with_noise(
        render_pair.render_counts(options.layout, scene_of(options), image, options.optics, rig=true),
        options.optics, 0, "rgb8",
    )  # fmt: skip
    for camera, name in enumerate(("left", "right")):
        assert np.abs(after[camera].astype(int) - expected[camera]).max() <= 1
        touched = side in (name, "projector")
        assert np.array_equal(after[camera], before[camera]) != touched
    assert rig.calibration == calibration


def test_a_rotation_keeps_the_position_and_a_shift_keeps_the_pose():
    options = from_mapping(OPTIONS)
    rig = TrueRig.of(options.layout, options.optics)
    turned = rig.after(Disturbance("right", turn_deg=(0.0, 0.01, 0.0)))
    assert turned.right.centre == pytest.approx(rig.right.centre, abs=1e-9)
    between = turned.right.rotation @ rig.right.rotation.T
    assert np.degrees(np.arccos((np.trace(between) - 1) / 2)) == pytest.approx(0.01, rel=1e-4)
    point = np.array([20.0, 10.0, 1400.0])
    moved = turned.right.project(point) - rig.right.project(point)
    assert moved[0] == pytest.approx(rig.right.matrix[0, 0] * np.radians(0.01), rel=0.02)
    shifted = rig.after(Disturbance("left", shift_px=(0.2, -0.1)))
    assert shifted.left.project(point) - rig.left.project(point) == pytest.approx([0.2, -0.1], abs=1e-9)
    assert shifted.left.rotation == pytest.approx(np.eye(3))
    stronger = rig.after(Disturbance("right", crosstalk=0.03))
    assert np.array_equal(stronger.crosstalk[0], rig.crosstalk[0])
    assert np.abs(stronger.crosstalk[1] - rig.crosstalk[1]).max() == pytest.approx(0.03)
    assert np.diag(stronger.crosstalk[1]) == pytest.approx([1, 1, 1])
    back = turned.after(Disturbance("right", turn_deg=(0.0, -0.01, 0.0)))
    assert back.right.rotation == pytest.approx(rig.right.rotation, abs=1e-12)


DISTURBANCE = [{"at": 2, "side": "right", "turn_deg": [0, 0.3, 0]}, {"at": 4, "side": "left", "shift_px": [1, 0]}]


def test_scripted_disturbances_come_at_their_triggers_live_and_in_a_loop(opened, tmp_path):
    live = opened({**OPTIONS, "disturb": DISTURBANCE[::-1]})
    loop = opened({**OPTIONS, "live": False, "frames": 2, "disturb": DISTURBANCE, "cache_dir": str(tmp_path)})
    image = live.options.layout.pattern().image()
    captures = [[captured(rig, image) for _ in range(6)] for rig in (live, loop)]
    for from_live, from_loop in zip(*captures, strict=True):
        for ours, theirs in zip(from_live, from_loop, strict=True):
            assert np.abs(ours.astype(int) - theirs).max() <= 1
    left, right = zip(*captures[0], strict=True)
    assert [np.array_equal(a, b) for a, b in pairwise(right)] == [True, False, True, True, True]
    assert [np.array_equal(a, b) for a, b in pairwise(left)] == [True, True, True, False, True]
    for rig in (live, loop):
        known = calibration.from_mapping(rig.calibration)
        assert known.right.rotation == pytest.approx(rig.options.layout.calibration().right.rotation)


def test_the_loop_before_a_disturbance_is_the_undisturbed_one(tmp_path):
    from sim.devices import rendered_loop as loops

    plain = from_mapping({**OPTIONS, "live": False, "frames": 2, "cache_dir": str(tmp_path)})
    loops.load_or_render(plain)
    (kept,) = tmp_path.iterdir()
    disturbed = from_mapping(
        {**OPTIONS, "live": False, "frames": 2, "cache_dir": str(tmp_path), "disturb": DISTURBANCE[:1]}
    )
    both = loops.loops_of(disturbed)
    assert len(list(tmp_path.iterdir())) == 2
    assert kept.exists()
    assert np.array_equal(both.pair(1)[0], loops.load_or_render(plain).pair(1)[0])
    # The same disturbance at another trigger needs no other loop.
    later = from_mapping({**OPTIONS, "live": False, "frames": 2, "cache_dir": str(tmp_path),
                          "disturb": [{**DISTURBANCE[0], "at": 50}]})  # fmt: skip
    assert np.array_equal(loops.loops_of(later).pair(50)[1], both.pair(2)[1])
    assert len(list(tmp_path.iterdir())) == 2


def test_triggers_at_a_rate_see_a_new_image_after_it_is_shown():
    rig = open_rig({**BOARD, "rate_hz": 200.0})
    try:
        rig.projector.open()
        for camera in rig.cameras.values():
            camera.open()
            camera.start()
        dark = rig.cameras["left"].read(30.0)
        rig.projector.show(images_of(rig)[0])
        given = rig.trigger.triggers
        frame = dark
        # The trigger that is being given meanwhile may still be dark; the one after it is not.
        while frame is None or (frame.trigger <= given):
            frame = rig.cameras["left"].read(30.0)
        assert dark.image.max() < 40 < frame.image.max()
    finally:
        rig.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"live": "yes"}, r"sim\.live is 'yes', expected bool"),
        ({"board": "circles:5x4:60"}, r"only scene 'board' has one"),
        ({"scene": "board", "board": "circles:5"}, r"sim\.board: board 'circles:5'"),
        ({"scene": "board", "poses": 0}, r"sim\.poses is 0"),
        ({"hold": 5}, r"sim\.hold is 5"),
        ({"disturb": {"side": "left"}}, r"sim\.disturb is .*, expected a list"),
        ({"disturb": [{"side": "top"}]}, r"sim\.disturb\[0\]\.side is 'top'"),
        ({"disturb": [{"side": "left", "turn": [0, 0, 1]}]}, r"sim\.disturb\[0\]\.turn is not an option"),
        ({"disturb": [{"side": "left", "turn_deg": [0, 0]}]}, r"sim\.disturb\[0\]: .*three numbers"),
        ({"disturb": [{"side": "left", "at": -1}]}, r"sim\.disturb\[0\]: disturb\.at is -1"),
        ({"disturb": [{"side": "projector", "crosstalk": 0.1}]}, r"the projector has none"),
        ({"disturb": [{"side": "left", "turn_deg": [0, 0, 90]}]}, r"at most 45 degrees"),
    ],
)
def test_wrong_options_are_named(change, message):
    with pytest.raises(OptionError, match=message):
        from_mapping({**OPTIONS, **change})
