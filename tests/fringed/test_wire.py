"""The wire format: what is written is read; what is damaged is refused by name and never otherwise."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.live.publishing import messages
from daemon.live.publishing.messages import Origin
from fringed import codecs, wire
from fringed.errors import CodecMissingError, WireError
from tests.daemon.live.publishing import clouds

ORIGIN = Origin("rig-t", "session-1", "sha256:00")
GOLDEN = Path(__file__).parent / "golden" / "cloud_full_v1.bin"
HEADER = wire.CloudHeader(kind="cloud", width=4, height=3)


def frames_of(topic: str) -> list[bytes]:
    item = clouds.item(17)
    made = messages.full(ORIGIN, item) if topic == "cloud/full" else messages.depth(ORIGIN, item)
    return [bytes(frame) for frame in made]


def with_header(**changes: object) -> list[bytes]:
    frames = frames_of("cloud/full")
    return [frames[0], json.dumps(json.loads(frames[1]) | changes).encode(), *frames[2:]]


def packed(frames: list[bytes]) -> bytes:
    return b"".join(len(frame).to_bytes(4, "little") + frame for frame in frames)


@pytest.mark.parametrize("dtype", wire.DTYPES)
@pytest.mark.parametrize("codec", codecs.CODECS)
def test_arrays_come_back_bit_for_bit(dtype: str, codec: str) -> None:
    array = np.random.default_rng(5).integers(0, 100, (7, 5, 2)).astype(dtype)
    message = wire.decode(wire.encode("t", HEADER, {"a": array, "b": array[:, ::2]}, rows={"a": {"codec": codec}}))
    np.testing.assert_array_equal(message.arrays["a"], array)
    np.testing.assert_array_equal(message.arrays["b"], array[:, ::2])
    assert message.arrays["a"].dtype.str == dtype and message.header.parts[0].codec == codec


def test_big_endian_arrays_are_turned_round() -> None:
    array = np.arange(6, dtype=">f4").reshape(2, 3)
    message = wire.decode(wire.encode("t", HEADER, {"a": array}))
    assert message.arrays["a"].dtype.str == "<f4"
    np.testing.assert_array_equal(message.arrays["a"], array)


def test_large_arrays_are_not_copied() -> None:
    array = np.zeros((64, 64), np.float32)
    frames = wire.encode("t", HEADER, {"a": array})
    assert np.shares_memory(np.frombuffer(frames[2], np.uint8), array)


def test_a_cloud_carries_all_keys_of_the_format() -> None:
    header = json.loads(frames_of("cloud/full")[1])
    wanted = "kind v seq t_ns session device frame unit width height calibration parts stats"
    assert set(wanted.split()) == set(header)
    assert [(row["name"], row["dtype"], row["codec"]) for row in header["parts"]] == [
        ("xyz", "<f4", "none"), ("gray", "|u1", "none"), ("sigma", "<f4", "none"),
    ]  # fmt: skip
    assert header["stats"] == {"valid": pytest.approx(0.9856, abs=1e-4), "latency_ms": 21.0, "dropped": 2}


def test_unknown_keys_are_passed_over() -> None:
    message = wire.decode(with_header(flavour="new", stats={"valid": 1, "more": [1, 2]}))
    assert message.header.seq == 17


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v": 2}, "version 2"),
        ({"v": "1"}, "header"),
        ({"width": 0}, "width"),
        ({"seq": -1}, "seq"),
        ({"parts": []}, "3 parts received"),
        ({"parts": [{"name": "a", "dtype": "|O", "shape": [1], "codec": "none"}] * 3}, "dtype"),
        ({"parts": [{"name": "a", "dtype": "|u1", "shape": [1 << 20] * 4, "codec": "none"}] * 3}, "limit"),
        ({"parts": [{"name": "a", "dtype": "|u1", "shape": [3, -1], "codec": "none"}] * 3}, "shape"),
        ({"parts": [{"name": "a", "dtype": "|u1", "shape": [3], "codec": "pickle"}] * 3}, "codec"),
        ({"parts": [{"name": "a", "dtype": "|u1", "shape": [3], "codec": "none"}] * 3}, "bytes received"),
        ({"parts": [{"name": "a", "dtype": "|u1", "shape": [3], "codec": "none"}] * 17}, "parts"),
        ({"session": "x" * 4096}, "limit 4096"),
    ],
)
def test_a_header_that_does_not_fit_is_refused_by_name(changes: dict[str, object], message: str) -> None:
    with pytest.raises(WireError, match=message):
        wire.decode(with_header(**changes))


def test_headers_that_are_no_json_are_refused() -> None:
    frames = frames_of("cloud/full")
    for head in (b"", b"\xff\xfe", b"[" * 4096, b"null", b'{"kind": "cloud"}', b'{"kind":"cloud","v":1' + b"0" * 4000):
        with pytest.raises(WireError):
            wire.decode([frames[0], head, *frames[2:]])
    for few in ([], [b"cloud/full"]):
        with pytest.raises(WireError, match="at least"):
            wire.decode(few)


def test_a_header_over_the_limit_is_not_sent() -> None:
    with pytest.raises(WireError, match="limit 4096"):
        wire.encode("t", wire.Header(kind="status", data={"long": "x" * 5000}))


@settings(max_examples=200, deadline=None)
@given(data=st.data(), topic=st.sampled_from(["cloud/full", "cloud/depth"]))
def test_a_damaged_message_raises_nothing_but_a_wire_error(data: st.DataObject, topic: str) -> None:
    frames = [bytearray(frame) for frame in frames_of(topic)]
    for _ in range(data.draw(st.integers(1, 4))):
        which = data.draw(st.integers(0, len(frames) - 1))
        place = data.draw(st.integers(0, max(0, min(len(frames[which]) - 1, 600))))
        kind = data.draw(st.sampled_from(["flip", "cut", "grow", "drop", "double"]))
        if kind == "flip" and frames[which]:
            frames[which][place] = data.draw(st.integers(0, 255))
        elif kind == "cut":
            del frames[which][place:]
        elif kind == "grow":
            frames[which] += b"\x00" * (place + 1)
        elif kind == "drop" and len(frames) > 1:
            del frames[which]
        elif kind == "double":
            frames.insert(which, bytearray(frames[which]))
    with contextlib.suppress(WireError):
        wire.decode([bytes(frame) for frame in frames])


def test_a_missing_codec_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = frames_of("cloud/depth")
    monkeypatch.setitem(sys.modules, "blosc2", None)
    with pytest.raises(CodecMissingError, match="pip install blosc2"):
        wire.decode(frames)


def test_depth_comes_back_within_half_a_step() -> None:
    z = clouds.item(3).cloud.xyz[..., 2]
    stored, scale, offset = messages.quantised(z)
    back = np.where(stored == 0, np.nan, stored * scale + offset)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(z))
    assert np.nanmax(np.abs(back - z)) <= scale / 2 + 1e-3 * scale
    assert (messages.quantised(np.full((2, 2), np.nan, np.float32))[0] == 0).all()


def test_deep_scenes_use_the_whole_range() -> None:
    z = np.array([[500.0, 500.1], [4000.0, np.nan]], np.float32)
    stored, scale, offset = messages.quantised(z)
    assert stored[0, 0] == 1 and stored[1, 0] == 65534 and stored[1, 1] == 0
    np.testing.assert_allclose(stored[[0, 1], [0, 0]] * scale + offset, [500, 4000], atol=1e-6)


def test_a_status_that_is_too_long_leaves_out_the_longest() -> None:
    message = wire.decode(messages.status(ORIGIN, {"state": "running", "reasons": ["x" * 9000]}, seq=1))
    assert message.header.data == {"state": "running", "left_out": ["reasons"]}


def test_log_lines_of_any_length_and_script_fit() -> None:
    for text in ("a" * 9000, "\x01" * 9000, "漢" * 9000, '"' * 9000):
        made = messages.log(ORIGIN, seq=1, t_ns=1, level="info", logger="fringed", text=text)
        assert len(made[1]) <= wire.MAX_HEADER_BYTES


def golden() -> bytes:
    return packed([bytes(frame) for frame in messages.full(ORIGIN, clouds.item(17, size=(16, 12)))])


def test_the_golden_message_is_still_written() -> None:
    """If this fails on purpose, the version number of the format must rise."""
    assert GOLDEN.read_bytes() == golden()
