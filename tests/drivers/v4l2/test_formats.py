"""Laws of the conversions: the size, the colours, padding that changes nothing, and short data that is refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.v4l2 import formats
from drivers.v4l2 import structs as v

COLOURS = {"red": (255, 0, 0), "green": (0, 255, 0), "blue": (0, 0, 255), "white": (255, 255, 255), "dark": (9, 9, 9)}
SITES = {"rggb": "RG/GB", "grbg": "GR/BG", "gbrg": "GB/RG", "bggr": "BG/GR"}
UNCOMPRESSED = [form for form in formats.FORMATS.values() if form.fourcc != "MJPG"]
BITS = {form.fourcc: int(form.alias[-2:]) for form in formats.FORMATS.values() if form.alias[-2:] in ("10", "12", "16")}
SIZE = (24, 10)


def encoded(code: str, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What a camera of this format sends for an image: (H, bytes of a row)."""
    form = formats.FORMATS[code]
    height = rgb.shape[0]
    if form.encoding == "rgb8":
        if code in ("RGB3", "BGR3"):
            return (rgb if code == "RGB3" else rgb[..., ::-1]).reshape(height, -1)
        luma = 16 + (65.481 * rgb[..., 0] + 128.553 * rgb[..., 1] + 24.966 * rgb[..., 2]) / 255
        blue = 128 + (-37.797 * rgb[..., 0] - 74.203 * rgb[..., 1] + 112.0 * rgb[..., 2]) / 255
        red = 128 + (112.0 * rgb[..., 0] - 93.786 * rgb[..., 1] - 18.214 * rgb[..., 2]) / 255
        chroma = blue.copy()
        chroma[:, 1::2] = red[:, ::2]
        pair = (luma, chroma) if code == "YUYV" else (chroma, luma)
        return np.rint(np.stack(pair, -1)).astype(np.uint8).reshape(height, -1)
    if form.encoding.startswith("bayer"):
        grey = np.empty(rgb.shape[:2], np.uint8)
        for row, letters in enumerate(SITES[form.encoding[6:10]].split("/")):
            for column, letter in enumerate(letters):
                grey[row::2, column::2] = rgb[row::2, column::2, "RGB".index(letter)]
    else:
        grey = rgb[..., 1].copy()
    bits = BITS.get(code, 8)
    if bits == 8:
        return grey
    deep = np.rint(grey.astype(float) * (2**bits - 1) / 255).astype("<u2")
    return deep.view(np.uint8).reshape(height, -1)


def constant(colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    return np.broadcast_to(np.array(colour, np.uint8), (*SIZE[::-1], 3)).copy()


def converted(code: str, rows: NDArray[np.uint8], padding: int = 0) -> formats.Image:
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xEE)
    layout = formats.Layout(SIZE, padded.shape[1])
    return formats.FORMATS[code].convert(memoryview(padded.tobytes()), layout)


@pytest.mark.parametrize("colour", COLOURS.values(), ids=COLOURS)
@pytest.mark.parametrize("form", UNCOMPRESSED, ids=lambda form: form.fourcc)
def test_a_constant_colour_stays_that_colour(form: formats.PixelFormat, colour: tuple[int, int, int]) -> None:
    rgb = constant(colour)
    image = converted(form.fourcc, encoded(form.fourcc, rgb))
    if form.encoding == "rgb8":
        tolerance = 3 if form.fourcc in ("YUYV", "UYVY") else 0
        assert np.abs(image.astype(int) - rgb).max() <= tolerance
    elif form.encoding == "mono16":
        assert image.dtype == np.uint16
        assert np.abs(image.astype(int) - 257 * colour[1]).max() <= 64
        assert image.max() == 65535 or colour[1] != 255, "white fills the 16 bits"
    elif form.encoding == "mono8":
        assert (image == colour[1]).all()
    else:
        assert np.abs(image.astype(int) - encoded(f"{plain(form)}", rgb)).max() <= 1


def plain(form: formats.PixelFormat) -> str:
    """The 8-bit format of the same mosaic."""
    return next(other.fourcc for other in formats.FORMATS.values() if other.encoding == form.encoding)


@pytest.mark.parametrize("form", UNCOMPRESSED, ids=lambda form: form.fourcc)
@given(seed=st.integers(0, 2**16), padding=st.integers(1, 40))
@settings(max_examples=10, deadline=None)
def test_padding_of_rows_changes_nothing(form: formats.PixelFormat, seed: int, padding: int) -> None:
    rows = encoded(form.fourcc, np.random.default_rng(seed).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8))
    assert np.array_equal(converted(form.fourcc, rows), converted(form.fourcc, rows, padding))


@pytest.mark.parametrize("form", UNCOMPRESSED, ids=lambda form: form.fourcc)
def test_the_image_is_a_copy_of_its_own(form: formats.PixelFormat) -> None:
    memory = bytearray(encoded(form.fourcc, constant((200, 100, 50))).tobytes())
    image = form.convert(memoryview(memory), formats.Layout(SIZE, len(memory) // SIZE[1]))
    before = image.copy()
    memory[:] = bytes(len(memory))
    assert np.array_equal(image, before) and image.flags.c_contiguous


@pytest.mark.parametrize("form", UNCOMPRESSED, ids=lambda form: form.fourcc)
def test_one_byte_too_few_is_no_image(form: formats.PixelFormat) -> None:
    data = encoded(form.fourcc, constant((1, 2, 3))).tobytes()
    with pytest.raises(formats.CorruptFrame) as caught:
        form.convert(memoryview(data)[:-1], formats.Layout(SIZE, len(data) // SIZE[1]))
    assert caught.value.reason == "short_frames"


def test_rows_are_views_into_the_buffer_until_the_conversion() -> None:
    memory = bytearray(range(240))
    rows = formats.Layout((20, 12), 20).rows(memoryview(memory), 1)
    memory[0] = 99
    assert rows[0, 0] == 99 and not rows.flags.writeable


def test_a_mosaic_keeps_every_pixel() -> None:
    rows = np.random.default_rng(1).integers(0, 256, SIZE[::-1], dtype=np.uint8)
    assert np.array_equal(converted("RGGB", rows), rows)


def jpeg(rgb: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()


@pytest.mark.parametrize("tail", [b"", bytes(300)], ids=["exact", "filled up"])
@pytest.mark.parametrize("colour", COLOURS.values(), ids=COLOURS)
def test_jpeg_keeps_a_constant_colour(colour: tuple[int, int, int], tail: bytes) -> None:
    image = formats.FORMATS["MJPG"].convert(memoryview(jpeg(constant(colour)) + tail), formats.Layout(SIZE, 0))
    assert np.abs(image.astype(int) - constant(colour)).max() <= 3


def test_a_jpeg_that_is_cut_anywhere_is_refused() -> None:
    whole = jpeg(np.random.default_rng(2).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8))
    for length in range(0, len(whole) - 1, 7):
        with pytest.raises(formats.CorruptFrame) as caught:
            formats.FORMATS["MJPG"].convert(memoryview(whole)[:length], formats.Layout(SIZE, 0))
        assert caught.value.reason == "corrupt_jpeg"


def test_a_jpeg_of_another_size_is_refused() -> None:
    with pytest.raises(formats.CorruptFrame):
        formats.FORMATS["MJPG"].convert(memoryview(jpeg(constant((1, 2, 3)))), formats.Layout((12, 10), 0))


def test_formats_are_known_by_code_and_by_name() -> None:
    for form in formats.FORMATS.values():
        assert formats.named(form.fourcc.lower()) is form and formats.named(form.alias) is form
    assert formats.named("H264") is None


@pytest.mark.parametrize(
    ("encoding", "quantization", "space", "noted"),
    [(0, 0, 8, False), (1, 2, 8, False), (2, 0, 8, True), (0, 1, 8, True), (0, 0, v.COLORSPACE_REC709, True)],
)
def test_other_colours_than_those_converted_are_noted(
    encoding: int, quantization: int, space: int, noted: bool
) -> None:
    pix = v.PixelFormat(ycbcr_enc=encoding, quantization=quantization, colorspace=space)
    assert bool(formats.colour_note(pix)) is noted
