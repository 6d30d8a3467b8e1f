from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from daemon.live.items import CloudItem, Pair
from daemon.recording.format import raw_image
from daemon.recording.format.errors import TakeError
from daemon.recording.read.take_reader import TakePair, TakeReader
from daemon.recording.write.part_writer import _schema
from tests.daemon.recording import independent_reader
from tests.daemon.recording.takes import CALIBRATION, SIZE, frame, pair, pairs_of, unpaired, write, writer
from tools.waiting import wait_until


def assert_is(read: TakePair, number: int, encoding: str = "rgb8") -> None:
    wrote = pair(number, encoding=encoding)
    assert (read.sequence, read.encoding, read.t_ns) == (number, encoding, wrote.left.t_exposure_ns)
    for got, put in ((read.left, wrote.left.image), (read.right, wrote.right.image)):
        assert got.dtype == put.dtype
        assert not got.flags.writeable
        np.testing.assert_array_equal(got, put)


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "mono8", "mono16"])
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_what_was_written_is_read(tmp_path: Path, encoding: str, compression: str) -> None:
    path = tmp_path / "take.mcap"
    status = write(path, [pair(n, encoding=encoding) for n in range(3)], compression=compression, rig_data=b"rig: 1\n")
    assert status["pairs"] == 3
    assert status["files"] == [str(path)]
    assert "problem" not in status
    assert [p.name for p in tmp_path.iterdir()] == ["take.mcap"]
    with TakeReader(path) as take:
        for number, read in enumerate(take.pairs()):
            assert_is(read, number, encoding)
        assert take.counts.pairs == 3
        assert take.truncated_at is None
        assert take.problems == []
        assert take.attachments["calibration.yaml"] == CALIBRATION
        assert take.attachments["rig.yaml"] == b"rig: 1\n"
        assert take.volume().far_mm == 1700
        assert take.metadata["session"] == "a session"


def test_an_independent_reader_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(4_294_967_295), pair(0), unpaired("right", 1)])
    read = independent_reader.read(path)
    assert read["schemas"] == ["foxglove.RawImage"]
    assert (
        read["metadata"]["fringed"] | {"version": "1", "session": "a session", "device": "rig-01"}
        == (read["metadata"]["fringed"])
    )
    assert read["attachments"]["calibration.yaml"] == ("application/yaml", CALIBRATION)
    assert read["attachments"]["volume.json"] == ("application/json", b'{"near_mm": 1200, "far_mm": 1700}')
    assert read["chunks"] == 3
    expected = [("left", 4_294_967_295), ("right", 4_294_967_295), ("left", 0), ("right", 0), ("right", 1)]
    assert [(topic, number) for topic, number, *_ in read["frames"]] == [(f"/{s}/image", n) for s, n in expected]
    for topic, number, publish_ns, log_ns, image, pixels in read["frames"]:
        side = topic.split("/")[1]
        wrote = frame(side, number)
        assert (publish_ns, log_ns) == (wrote.t_exposure_ns, wrote.t_host_ns)
        assert image.timestamp.ToNanoseconds() == publish_ns
        assert (image.frame_id, image.encoding, image.step) == (side, "rgb8", SIZE[1] * 3)
        np.testing.assert_array_equal(pixels, wrote.image)


def test_pairs_come_whatever_the_order_and_double_frames_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    rights = [unpaired("right", n) for n in range(30)]
    lefts = [unpaired("left", n) for n in range(29, -1, -1)]
    write(path, [*rights, *lefts, unpaired("left", 3), unpaired("right", 3), unpaired("left", 99)])
    with TakeReader(path) as take:
        pairs = list(take.pairs())
        assert [p.sequence for p in pairs] == list(range(29, -1, -1))
        for read in pairs:
            assert_is(read, read.sequence)
        assert dict(take.counts.duplicates) == {"left": 1, "right": 1}
        assert dict(take.counts.unpaired) == {"left": 1}
        assert dict(take.counts.frames) == {"left": 32, "right": 31}
        assert len(list(take.pairs())) == 30


def test_foreign_takes_with_padded_rows_and_other_topics_are_read(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    image = frame("left", 1, encoding="mono16").image
    height, width = image.shape
    padded = np.zeros((height, 2 * width + 7), np.uint8)
    padded[:, : 2 * width] = np.ascontiguousarray(image, "<u2").view(np.uint8)
    message = raw_image.encode(5, "left", "mono16", image)
    head = message[: message.index(b"\x32" + raw_image._varint(image.nbytes))]
    old, new = (b"\x2d" + step.to_bytes(4, "little") for step in (2 * width, 2 * width + 7))
    message = head.replace(old, new) + b"\x32" + raw_image._varint(padded.nbytes) + padded.tobytes()
    with path.open("wb") as file:
        out = Writer(file, compression=CompressionType.NONE, use_chunking=False)
        out.start()
        other = out.register_channel("/notes", "json", 0)
        schema = out.register_schema("foxglove.RawImage", "protobuf", _schema())
        channels = [out.register_channel(f"/{side}/image", "protobuf", schema) for side in ("left", "right")]
        out.add_message(other, 1, b"{}", 1)
        for channel in channels:
            out.add_message(channel, 1, message, 1, sequence=7)
        out.finish()
    (read,) = pairs_of(path)
    np.testing.assert_array_equal(read.left, image)
    assert read.left.flags.c_contiguous
    assert read.left.flags.aligned


def test_a_cut_at_any_byte_loses_only_the_end(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    write(whole, [pair(n) for n in range(6)])
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    rng = np.random.default_rng(1)
    positions = sorted({0, 3, 8, len(data) - 1, *rng.integers(0, len(data), 40).tolist()})
    counts = []
    for position in positions:
        cut.write_bytes(data[:position])
        try:
            with TakeReader(cut) as take:
                pairs = list(take.pairs())
                assert take.truncated_at is not None
                assert take.truncated_at <= position
                assert any("cut off" in problem for problem in take.problems)
        except TakeError as error:
            assert str(cut) in str(error)
            assert position < 8
            continue
        assert [p.sequence for p in pairs] == list(range(len(pairs)))
        for read in pairs:
            assert_is(read, read.sequence)
        counts.append(len(pairs))
    assert counts == sorted(counts)
    assert counts[-1] == 6
    assert sum(0 < count < 6 for count in counts) > 0


def test_flipped_bytes_never_give_a_wrong_pair(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    write(whole, [pair(n) for n in range(6)])
    data = whole.read_bytes()
    bad = tmp_path / "bad.mcap"
    rng = np.random.default_rng(2)
    for position in rng.integers(0, len(data), 40).tolist():
        broken = bytearray(data)
        broken[position] ^= int(rng.integers(1, 256))
        bad.write_bytes(broken)
        try:
            with TakeReader(bad) as take:
                pairs = list(take.pairs())
                assert len(pairs) == 6 or take.problems
                assert take.attachments.get("calibration.yaml", CALIBRATION) == CALIBRATION
        except TakeError as error:
            assert str(bad) in str(error)
            continue
        for read in pairs:
            assert_is(read, read.sequence)


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04 something else altogether", b"\x89MCAP0\r\n" + b"\xff" * 64])
def test_other_files_are_refused_by_name_or_empty(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    try:
        with TakeReader(path) as take:
            assert list(take.pairs()) == []
            assert take.problems
    except TakeError as error:
        assert str(path) in str(error)


def test_a_missing_file_and_an_empty_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(TakeError, match=r"none\.mcap: No such file"):
        TakeReader(tmp_path / "none.mcap")
    with pytest.raises(TakeError, match=r"no \.mcap file"):
        TakeReader(tmp_path)


@pytest.mark.parametrize("name", ["take.mcap", ""])
def test_rotation_keeps_pairs_together(tmp_path: Path, name: str) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    status = write(takes / "take.mcap", [pair(n) for n in range(12)], max_part_bytes=20_000)
    assert len(status["files"]) > 3
    assert sorted(str(p) for p in takes.iterdir()) == status["files"]
    for file in status["files"]:
        read = independent_reader.read(Path(file))
        assert set(read["attachments"]) == {"calibration.yaml", "pattern.json", "volume.json"}
        numbers = [n for topic, n, *_ in read["frames"] if topic == "/left/image"]
        assert numbers == [n for topic, n, *_ in read["frames"] if topic == "/right/image"]
    assert [p.sequence for p in pairs_of(takes / name)] == list(range(12))


def test_a_damaged_index_costs_nothing(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    write(path, [pair(n) for n in range(2)])
    data = path.read_bytes()
    with TakeReader(path) as take:
        end = take.parts[0].index.data[-1].end
    rng = np.random.default_rng(4)
    for at in rng.integers(end + 100, len(data), 150):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        assert [p.sequence for p in pairs_of(path)] == [0, 1]


def test_a_part_ends_by_its_duration(tmp_path: Path) -> None:
    status = write(tmp_path / "take.mcap", [pair(n) for n in range(10)], max_part_s=0.1)  # 33 ms a pair
    assert len(status["files"]) == 3
    assert [p.sequence for p in pairs_of(tmp_path / "take.mcap")] == list(range(10))


def test_a_disk_that_cannot_keep_the_data_ends_the_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    recorder = writer(tmp_path / "take.mcap")
    monkeypatch.setattr("daemon.recording.write.disk_sync.os.fdatasync", broken)
    assert recorder.offer(pair(0))
    wait_until(lambda: not recorder.offer(pair(1)))
    recorder.close()
    assert "Input/output error" in recorder.status()["problem"]


def test_what_was_written_is_synced_while_the_take_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    recorder = writer(tmp_path / "take.mcap")
    monkeypatch.setattr(
        "daemon.recording.write.disk_sync.os.fdatasync", lambda handle: synced.append(os.fstat(handle).st_size)
    )
    assert recorder.offer(pair(0))
    wait_until(lambda: bool(synced))
    assert synced[0] >= 2 * pair(0).left.image.nbytes
    recorder.close()


def test_an_image_that_cannot_be_recorded_costs_only_its_pair(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    wrong = Pair(pair(1).left, frame("right", 1, encoding="mono8", size=(0, 7)))
    status = write(path, [pair(0), wrong, pair(2)])
    assert status["dropped"] == {"refused": 1}
    assert "problem" not in status
    with TakeReader(path) as take:
        assert [p.sequence for p in take.pairs()] == [0, 2]
        assert take.counts.unpaired.total() == 0


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        writer(path)
    assert path.read_bytes() == b"precious"


def test_clouds_are_not_for_the_recorder(tmp_path: Path) -> None:
    recorder = writer(tmp_path / "take.mcap")
    item = pair(0)
    cloud: Any = None
    assert recorder.offer(CloudItem(0, 0, cloud, item.left, item.right, 0.0))
    recorder.close()
    assert pairs_of(tmp_path / "take.mcap") == []


@pytest.mark.parametrize(
    ("encoding", "image"),
    [("rgb8", np.zeros((4, 4), np.uint8)), ("mono16", np.zeros((4, 4), np.uint8)), ("jpeg", np.zeros(4, np.uint8))],
)
def test_an_image_that_contradicts_its_encoding_is_not_written(encoding: str, image: Any) -> None:
    with pytest.raises(TakeError, match="encoding"):
        raw_image.encode(0, "left", encoding, image)


@pytest.mark.shared
def test_the_public_stereo_pair_is_read(shared_data: Any) -> None:
    with TakeReader(shared_data("bust", "take.mcap")) as take:
        (read,) = take.pairs()
        assert read.left.shape == read.right.shape == (768, 1024, 3)
        assert take.calibration().identity.startswith("sha256:")
        assert take.attachments["calibration.yaml"] == shared_data("bust", "calibration.yaml").read_bytes()
        assert take.pattern().periods == 32
        assert take.problems == []


def test_a_file_that_appears_under_the_takes_name_meanwhile_is_kept_and_so_is_the_take(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    recorder = writer(path)
    assert recorder.offer(pair(0))
    path.write_bytes(b"another file")
    recorder.close()
    assert "appeared while the take was being written" in recorder.status()["problem"]
    assert path.read_bytes() == b"another file"
    (read,) = pairs_of(path.with_name("take.mcap.partial"))
    assert_is(read, 0)


def test_a_file_that_appears_after_a_check_of_the_takes_name_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "take.mcap"
    recorder = writer(path)
    assert recorder.offer(pair(0))
    path.write_bytes(b"another file")
    monkeypatch.setattr(Path, "exists", lambda _: False)  # as a check before the file appeared
    recorder.close()
    assert "appeared while the take was being written" in recorder.status()["problem"]
    assert path.read_bytes() == b"another file"
