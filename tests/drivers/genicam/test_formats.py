"""Pixel formats against slow and obvious references."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.genicam.formats import BY_CODE, BY_NAME, PixelFormat, convert
from sim.gentl.features import PIXEL_FORMATS

WIDTH, HEIGHT = 12, 6


def packed(values: list[int], pixels: PixelFormat) -> bytes:
    """What a camera sends for these values."""
    if pixels.packing == "p":
        bits = "".join(f"{value:0{pixels.depth}b}"[::-1] for value in values)
        bits += "0" * (-len(bits) % 8)
        return bytes(int(bits[k : k + 8][::-1], 2) for k in range(0, len(bits), 8))
    if pixels.packing == "packed":
        low = pixels.depth - 8
        out = []
        for a, b in zip(values[::2], [*values, 0][1::2], strict=False):
            out += [a >> low, (a & (1 << low) - 1) | (b & (1 << low) - 1) << 4, b >> low]
        return bytes(out)
    size = 1 if pixels.depth == 8 else 2
    return b"".join(value.to_bytes(size, "little") for value in values)


def expected(value: int, pixels: PixelFormat) -> int:
    full = (1 << pixels.depth) - 1
    return value if pixels.depth == 8 else round(value * (65535 if pixels.encoding == "mono16" else 255) / full)


def converted(raw: bytes, pixels: PixelFormat, width: int, height: int, padding: int = 0) -> Any:
    out = np.full(pixels.frame_shape(width, height), 77, pixels.dtype)
    convert(np.frombuffer(raw, np.uint8), pixels, width, height, out, padding=padding)
    return out


GREY = [pixels for pixels in BY_CODE.values() if pixels.encoding != "rgb8"]


@pytest.mark.parametrize("pixels", GREY, ids=lambda pixels: pixels.name)
def test_every_value_comes_out_right(pixels: PixelFormat) -> None:
    count = 1 << pixels.depth
    values = np.random.default_rng(1).permutation(count)
    height = 16
    out = converted(packed([int(v) for v in values], pixels), pixels, count // height, height).reshape(-1)
    wanted = np.array([expected(int(v), pixels) for v in values])
    if pixels.encoding == "mono16":
        assert np.abs(out.astype(int) - wanted).max() <= 1
        assert out[values == 0] == 0 and out[values == count - 1] == 65535
        assert (np.diff(out[np.argsort(values)].astype(int)) > 0).all()
    else:
        assert (out == wanted).all()


@pytest.mark.parametrize("pixels", GREY, ids=lambda pixels: pixels.name)
@pytest.mark.parametrize(("width", "padding"), [(12, 0), (12, 3), (11, 0), (11, 5)])
def test_widths_and_padding(pixels: PixelFormat, width: int, padding: int) -> None:
    if pixels.packing == "packed" and width % 2:
        width += 1  # GigE Vision packs whole pairs
    rng = np.random.default_rng(2)
    values = rng.integers(0, 1 << pixels.depth, (HEIGHT, width))
    if padding:
        raw = b"".join(packed([int(v) for v in line], pixels) + b"\xee" * padding for line in values)
    else:
        raw = packed([int(v) for v in values.reshape(-1)], pixels)
    out = converted(raw, pixels, width, HEIGHT, padding)
    wanted = np.vectorize(lambda v: expected(int(v), pixels))(values)
    assert np.abs(out.astype(int) - wanted).max() <= (pixels.encoding == "mono16")


def test_colours_keep_their_places() -> None:
    image = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    assert (converted(image.tobytes(), BY_NAME["RGB8"], WIDTH, HEIGHT) == image).all()
    assert (converted(image.tobytes(), BY_NAME["BGR8"], WIDTH, HEIGHT) == image[..., ::-1]).all()
    lines = b"".join(line.tobytes() + b"\xee" * 4 for line in image)
    assert (converted(lines, BY_NAME["RGB8"], WIDTH, HEIGHT, 4) == image).all()


@pytest.mark.parametrize("pixels", BY_CODE.values(), ids=lambda pixels: pixels.name)
def test_too_few_bytes_are_refused(pixels: PixelFormat) -> None:
    whole = (WIDTH * HEIGHT * pixels.bits + 7) // 8
    converted(bytes(whole + 50), pixels, WIDTH, HEIGHT)
    with pytest.raises(ValueError, match=f"has {whole} bytes; {whole - 1} came"):
        converted(bytes(whole - 1), pixels, WIDTH, HEIGHT)


def test_names_and_codes_agree_with_an_independent_table() -> None:
    for name, code in PIXEL_FORMATS.items():
        assert BY_NAME[name].code == code
        assert BY_CODE[code].name == name
        assert BY_NAME[name].bits == code >> 16 & 0xFF
