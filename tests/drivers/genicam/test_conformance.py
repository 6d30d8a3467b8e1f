"""What every camera of every producer must do, each with what it has."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.genicam import discover, open_camera
from drivers.protocols import Camera, CameraInfo, Frame
from tests.drivers.genicam import producers
from tests.drivers.genicam.producers import Ability


@dataclass
class Bench:
    """One producer, and how to make cameras of it."""

    ability: Ability
    library: Path
    make: Callable[..., Camera]

    def camera(self, **changes: Any) -> Camera:
        ability = self.ability
        options = {"producer": str(self.library), **ability.select, "trigger": ability.trigger, **ability.options}
        return self.make({**options, **changes})


# Old feature names are tried in test_ours as well.
PRODUCERS = [pytest.param(one, marks=pytest.mark.long) if one is producers.OURS_OLD else one for one in producers.ALL]


refusing = pytest.mark.parametrize(
    "bench",
    [pytest.param(one, marks=pytest.mark.long) if one is producers.VIKY else one for one in PRODUCERS],
    ids=[one.name for one in producers.ALL],
    indirect=True,
)
"""Refusals are the driver's own: two producers prove them."""


@pytest.fixture(scope="module", params=PRODUCERS, ids=lambda ability: ability.name)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    ability: Ability = request.param
    with ExitStack() as stack:
        world = stack.enter_context(tempfile.TemporaryDirectory(prefix="cams-"))
        stack.enter_context(pytest.MonkeyPatch.context()).setenv("FRINGED_GENTL_DIR", world)
        if ability.name.startswith("ours"):
            stack.enter_context(producers.cables(Path(world), old=ability.name == "ours_old"))

        def make(options: dict[str, Any]) -> Camera:
            camera = open_camera("left", options, Path("/"))
            stack.callback(camera.close)
            return camera

        yield Bench(ability, producers.library(ability.name), make)


@pytest.fixture(scope="module")
def opened(bench: Bench) -> tuple[Camera, CameraInfo]:
    """A camera that is open for several tests, and what opening it returned; who starts it stops it."""
    camera = bench.camera()
    return camera, camera.open()


@pytest.fixture
def camera(opened: tuple[Camera, CameraInfo]) -> Camera:
    return opened[0]


def frames(camera: Camera, count: int) -> list[Frame]:
    end = time.monotonic() + 20
    found: list[Frame] = []
    while len(found) < count and time.monotonic() < end:
        frame = camera.read(0.2)
        found += [] if frame is None else [frame]
    assert len(found) == count
    return found


def test_cameras_are_found(bench: Bench) -> None:
    found = discover([bench.library])
    assert len(found) == bench.ability.cameras
    assert len({camera.serial for camera in found}) == len(found)
    for camera in found:
        assert camera.model
        assert camera.vendor
        assert camera.producer == str(bench.library)
        open_here = camera.serial == bench.ability.select["serial"]  # the one that several tests share
        assert camera.access in ("free", "open", "unknown", "in use" if open_here else "free")


def test_frames_are_numbered_and_timed(bench: Bench, opened: tuple[Camera, CameraInfo]) -> None:
    ability = bench.ability
    camera, info = opened
    assert (info.model, info.size, info.encoding) == (ability.model, ability.size, ability.encoding)
    assert any("clock cannot be read" in note for note in info.notes) != ability.latches
    camera.start()
    found = frames(camera, 12)
    width, height = ability.size
    for frame in found:
        assert frame.image.shape[:2] == (height, width)
        assert not frame.image.flags.writeable
        assert frame.encoding == ability.encoding
        assert frame.t_exposure_ns <= frame.t_host_ns
        assert frame.t_host_ns - frame.t_exposure_ns < 10**9
        assert abs(frame.t_host_ns - time.time_ns()) < 60 * 10**9
        assert (frame.t_device_ns is not None) == ability.stamps
        assert (frame.frame_id is not None) == ability.ids
    numbers = [frame.trigger for frame in found]
    steps = {later - earlier for earlier, later in itertools.pairwise(numbers)}
    assert min(steps) > 0
    if not ability.holes:
        assert steps == {1}
    times = [frame.t_exposure_ns for frame in found]
    assert times == sorted(times)
    camera.stop()


def test_each_start_restarts_the_count(bench: Bench, camera: Camera) -> None:
    for _ in range(3):
        camera.start()
        assert frames(camera, 3)[0].trigger < 3 or bench.ability.holes
        camera.stop()
        assert camera.read(0.1) is None


def test_a_closed_camera_opens_again(camera: Camera) -> None:
    camera.start()
    frames(camera, 2)
    camera.close()
    with pytest.raises(DeviceLost):
        camera.read(0.1)
    camera.open()
    camera.start()
    frames(camera, 2)
    camera.stop()


def test_health(bench: Bench, camera: Camera) -> None:
    end = time.monotonic() + 10
    while not camera.health().counters.get("processes") or "incomplete" not in camera.health().counters:
        assert time.monotonic() < end
        time.sleep(0.02)
    assert (camera.health().temperature_c is not None) == bench.ability.temperature


@refusing
def test_a_camera_that_is_not_there_names_those_that_are(bench: Bench) -> None:
    with pytest.raises(DeviceLost, match=f"serial 'unknown'.*there are.*{bench.ability.model}"):
        bench.camera(serial="unknown").open()


@refusing
def test_options_that_fit_several_are_refused(bench: Bench) -> None:
    if bench.ability.several:
        everyone = dict.fromkeys(bench.ability.select)
        with pytest.raises(DriverError, match=r"cameras with model .* name one of them by its serial"):
            bench.camera(**everyone, **bench.ability.several).open()


@refusing
def test_a_format_that_is_not_there_names_those_that_are(bench: Bench) -> None:
    with pytest.raises(SettingRefused, match=r"PixelFormat cannot be set to Mono9000: there are .*Mono8"):
        bench.camera(**bench.ability.spare, pixel_format="Mono9000").open()


@refusing
def test_a_feature_that_is_not_there_is_named(bench: Bench) -> None:
    with pytest.raises(SettingRefused, match="NoSuchFeature cannot be set to 1"):
        bench.camera(**bench.ability.spare, features={"NoSuchFeature": 1}).open()


def test_a_camera_in_use_is_reported(bench: Bench, camera: Camera) -> None:
    second = bench.camera()
    if bench.ability.exclusive:
        with pytest.raises(DeviceLost, match="in use"):
            second.open()
    else:
        second.open()
        second.close()
    camera.start()
    frames(camera, 2)
    assert len(discover([bench.library])) == bench.ability.cameras
    frames(camera, 2)
    camera.stop()
