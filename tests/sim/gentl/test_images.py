"""What the sensor saw comes out of the bytes: formats, regions, chunks, response."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.gentl.cable import Cable
from sim.gentl.features import PIXEL_FORMATS
from sim.gentl.memory import SLOTS
from tests.sim.gentl.conftest import HEIGHT, WIDTH
from tests.sim.gentl.host import WAIT_S, AccessException, Capture, Host, opened

Cables = Callable[..., Cable]
Samples = NDArray[np.uint16]
CHANNELS = {"R": 0, "G": 1, "B": 2}


def one_capture(host: Host, camera: Cable) -> Capture:
    """A frame of what is shown."""
    assert camera.pulse()
    assert camera.wait_idle(WAIT_S)
    return host.captures(1)[0]


def decoded(name: str, capture: Capture) -> Samples:
    """Samples of a frame, by the Pixel Format Naming Convention."""
    width, height = capture.size
    depth = int(re.sub(r"\D", "", name))
    count = width * height * (3 if name == "RGB8" else 1)
    raw = np.frombuffer(capture.bytes, np.uint8)
    if name.endswith("p"):
        bits = np.unpackbits(raw, bitorder="little")[: count * depth].reshape(count, depth)
        values = (bits.astype(np.uint16) << np.arange(depth, dtype=np.uint16)).sum(axis=1).astype(np.uint16)
    else:
        values = raw.view("<u2" if depth > 8 else np.uint8).astype(np.uint16)
    assert values.size == count, f"{name}: {raw.size} bytes for {count} samples"
    return values.reshape((height, width, 3) if name == "RGB8" else (height, width))


def expected(name: str, light: NDArray[np.uint16]) -> Samples:
    """Samples that light (H, W, 3), 16 bits, gives in a format."""
    shift = 16 - int(re.sub(r"\D", "", name))
    if name.startswith("Mono"):
        red, green, blue = (light[..., c].astype(np.uint32) for c in range(3))
        return ((red + 2 * green + blue) // 4 >> shift).astype(np.uint16)
    if name == "RGB8":
        return light >> shift
    first, second = name[5], name[6]
    third = "G" if second == "G" else {"R": "B", "B": "R"}[second]
    fourth = {"R": "B", "B": "R", "G": "G"}[first]
    rows = [[first, second], [third, fourth]]
    values = np.empty(light.shape[:2], np.uint16)
    for y in range(2):
        for x in range(2):
            values[y::2, x::2] = light[y::2, x::2, CHANNELS[rows[y][x]]]
    return values >> shift


@pytest.mark.parametrize("sensor", ["mono", "RG", "GR", "GB", "BG"])
def test_each_format_decodes_to_the_image_shown_and_others_are_refused(
    producer: Path, cable: Cables, image: NDArray[np.uint8], sensor: str
) -> None:
    camera = cable(sensor=sensor)
    offered = {
        name
        for name in PIXEL_FORMATS
        if name.startswith("Mono") or (sensor != "mono" and name in (f"Bayer{sensor}{name[7:]}", "RGB8"))
    }
    with opened(producer, "CAM0") as (host,):
        assert set(host.nodes.PixelFormat.symbolics) == offered
        host.trigger_on()
        for name in sorted(offered):
            host.set(PixelFormat=name)
            host.start(buffers=3)
            for light in image, image.astype(np.uint16) * 257 ^ 0x5A:
                camera.show(light)
                wide = light.astype(np.uint16) << 8 if light.dtype == np.uint8 else light
                np.testing.assert_array_equal(decoded(name, one_capture(host, camera)), expected(name, wide), name)
            host.stop()
        for name in sorted(set(PIXEL_FORMATS) - offered):
            with pytest.raises(AccessException, match="PixelFormat"):
                host.set(PixelFormat=name)


def test_grey_light_is_the_same_through_every_filter(producer: Path, cable: Cables) -> None:
    camera = cable()
    gray = np.arange(HEIGHT * WIDTH, dtype=np.uint8).reshape(HEIGHT, WIDTH)
    camera.show(gray)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        for name in "Mono8", "BayerRG8":
            host.set(PixelFormat=name)
            host.start()
            assert one_capture(host, camera).bytes == gray.tobytes()
            host.stop()


@pytest.mark.parametrize("name", ["BayerRG8", "RGB8", "Mono12p"])
@pytest.mark.parametrize("region", [(16, 4, 0, 0), (24, 10, 20, 6), (16, 4, WIDTH - 16, HEIGHT - 4)])
def test_a_region_is_the_crop_of_the_whole(
    producer: Path, cable: Cables, image: NDArray[np.uint8], name: str, region: tuple[int, int, int, int]
) -> None:
    width, height, x, y = region
    camera = cable()
    camera.show(image)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(PixelFormat=name, Width=width, Height=height, OffsetX=x, OffsetY=y)
        host.start()
        capture = one_capture(host, camera)
        assert (capture.size, capture.offset) == ((width, height), (x, y))
        whole = expected(name, image.astype(np.uint16) << 8)
        np.testing.assert_array_equal(decoded(name, capture), whole[y : y + height, x : x + width])


def test_regions_beyond_the_sensor_are_refused(producer: Path, cable: Cables) -> None:
    cable()
    with opened(producer, "CAM0") as (host,):
        assert (host.get("WidthMax"), host.get("HeightMax")) == (WIDTH, HEIGHT)
        host.set(Width=16, OffsetX=WIDTH - 16)
        assert host.nodes.Width.max == 16
        for name, value in ("Width", 20), ("OffsetX", WIDTH), ("Height", HEIGHT + 2), ("Width", 18), ("OffsetY", 1):
            with pytest.raises(Exception, match=name):
                host.set(**{name: value})
        host.set(OffsetX=0, Width=WIDTH)


def test_chunks_hold_the_values_of_their_names(producer: Path, cable: Cables) -> None:
    camera = cable()
    camera.set_clock(offset_ns=123_456_789)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=4321.5)
        host.chunks_on()
        host.start()
        t_ns = time.monotonic_ns()
        for k, later in enumerate((0, 1_000_000, 10_000_000)):
            assert camera.pulse(t_ns + later)
            assert camera.wait_idle(WAIT_S)
            if k == 1:
                continue  # missed
            (capture,) = host.captures(1)
            wanted = {"Timestamp": camera.device_ns(t_ns + later), "FrameID": capture.frame_id, "ExposureTime": 4321.5}
            assert capture.chunks == wanted | {"TriggersMissed": int(k > 0)}


def test_only_enabled_chunks_come(producer: Path, cable: Cables, image: NDArray[np.uint8]) -> None:
    camera = cable()
    camera.show(image)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(PixelFormat="RGB8", ChunkModeActive=True, ChunkSelector="FrameID", ChunkEnable=True)
        host.set(ChunkSelector="Timestamp")
        assert host.get("ChunkEnable") is False
        assert host.get("PayloadSize") == image.nbytes + 8
        host.start()
        assert camera.pulse()
        assert camera.wait_idle(WAIT_S)
        assert camera.state().delivered == 1


def test_a_pulse_exposes_the_image_that_was_shown_when_it_was_given(producer: Path, cable: Cables) -> None:
    """Even if the world has shown others before the camera's process came to it."""
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=100.0)
        host.start(buffers=40)
        for round_ in range(10):
            for k in range(3):
                camera.show(np.full((HEIGHT, WIDTH), 4 * round_ + k, np.uint8))
                assert camera.pulse(time.monotonic_ns() + k * 3_000_000)
            assert camera.wait_idle(WAIT_S)
        assert [capture.bytes[0] for capture in host.captures(30)] == [4 * r + k for r in range(10) for k in range(3)]
        assert camera.state().overwritten == 0


def test_an_overwritten_image_is_lost_and_never_replaced_by_another(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=100.0)
        host.start()
        camera.show(np.full((HEIGHT, WIDTH), 100, np.uint8))
        assert camera.pulse(time.monotonic_ns() + 2_000_000_000)  # the world is faster than the camera's process
        for k in range(SLOTS):
            camera.show(np.full((HEIGHT, WIDTH), k, np.uint8))
        assert camera.wait_idle(WAIT_S)
        assert camera.pulse()
        assert camera.wait_idle(WAIT_S)
        (capture,) = host.captures(1)
        state = camera.state()
        assert (capture.bytes[0], state.exposed, state.delivered, state.overwritten) == (SLOTS - 1, 2, 1, 1)


def test_no_image_is_torn_however_fast_they_change(producer: Path, cable: Cables) -> None:
    camera = cable(real_time=True, size=(256, 256), readout_us=100.0)
    with opened(producer, "CAM0") as (host,):
        host.set(ExposureTime=50.0)
        host.start()
        for k in range(200):
            camera.show(np.full((256, 256), k, np.uint8))
        taken = camera.state().delivered
        while camera.state().delivered < taken + 30:
            for k in range(20):
                camera.show(np.full((256, 256), k, np.uint8))
            capture = host.captures(1)[0]
            assert capture.bytes == capture.bytes[:1] * len(capture.bytes)


def test_gain_black_level_and_gamma_change_the_values(producer: Path, cable: Cables) -> None:
    camera = cable(sensor="mono", reference_exposure_us=1000.0)
    ramp = np.arange(HEIGHT * WIDTH, dtype=np.uint8).reshape(HEIGHT, WIDTH)
    camera.show(ramp)
    with opened(producer, "CAM0") as (host,):
        host.trigger_on()
        host.set(ExposureTime=1000.0)
        host.start()

        def seen(**settings: object) -> NDArray[np.float64]:
            host.set(**settings)
            return np.frombuffer(one_capture(host, camera).bytes, np.uint8).astype(np.float64)

        light = ramp.ravel().astype(np.float64)
        np.testing.assert_array_equal(seen(), light)
        np.testing.assert_allclose(seen(Gain=6.0), np.minimum(light * 10**0.3, 255), atol=1.01)
        np.testing.assert_allclose(seen(Gain=0.0, BlackLevel=10.0), np.minimum(light + 10, 255), atol=1.01)
        np.testing.assert_allclose(seen(BlackLevel=0.0, ExposureTime=500.0), light / 2, atol=1.01)
        settings = seen(ExposureTime=1000.0, GammaEnable=True, Gamma=0.5)
        np.testing.assert_allclose(settings, 255 * np.sqrt(light / 255), atol=1.01)


def test_automatics_change_the_image_until_they_are_off(
    producer: Path, cable: Cables, image: NDArray[np.uint8]
) -> None:
    camera = cable(automatic=True)
    dim = image // 4 + np.array([0, 0, 9], np.uint8)
    camera.show(dim)
    with opened(producer, "CAM0") as (host,):
        assert host.get("ExposureAuto") == host.get("GainAuto") == host.get("BalanceWhiteAuto") == "Continuous"
        host.trigger_on()
        host.set(PixelFormat="RGB8")
        host.start()
        exposure_us = host.get("ExposureTime")
        assert one_capture(host, camera).bytes != dim.tobytes()
        assert host.get("ExposureTime") != exposure_us
        assert host.get("Gain") > 6
        host.set(ExposureAuto="Off", GainAuto="Off", BalanceWhiteAuto="Off", GammaEnable=False, Gain=0.0)
        for name in "Red", "Green", "Blue":
            host.set(BalanceRatioSelector=name, BalanceRatio=1.0)
        assert one_capture(host, camera).bytes == dim.tobytes()
