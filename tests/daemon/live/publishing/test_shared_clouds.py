"""Clouds in shared memory: the same as through the socket, never a mixture of two, and limits that hold."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.live.publishing import shared_clouds
from daemon.live.publishing.shared_clouds import LEAST_SLOTS, MOST_SLOTS, SharedClouds
from fringed import FringedError, subscribe
from fringed.errors import OverwrittenError, SharedMemoryError, WireError
from fringed.parts import BASIC, PARTS, copied_topic, shared_topic
from fringed.shared_memory import Reference, SharedMemory
from fringed.stream.subscription import Subscription
from tests.daemon.live.publishing import clouds
from tests.daemon.live.publishing.test_parts import WAIT_S, rich
from tools.waiting import wait_until

MEBIBYTE = 1 << 20


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place of its own instead of the machine's shared memory, where other daemons have files."""
    (tmp_path / "memory").mkdir()
    monkeypatch.setattr(shared_clouds, "_MEMORY", tmp_path / "memory")


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/s"


@pytest.fixture
def ring(endpoint: str, tmp_path: Path) -> Any:
    (tmp_path / "s").touch()
    made = SharedClouds([endpoint], limit_bytes=MEBIBYTE)
    yield made
    made.close()


def files(directory: Path) -> list[Path]:
    """Files of shared memory beside a socket, or in what stands for the machine's."""
    return list(directory.rglob("fringed-*-*"))


def read(reference: bytes, size: int, memory: SharedMemory) -> Any:
    return memory.read(memoryview(reference), size, "topic, part 'xyz'")


def test_a_subscriber_gets_the_same_as_through_the_socket(endpoint: str) -> None:
    with (
        clouds.publisher(endpoint) as made,
        subscribe(endpoint, parts=list(PARTS), timeout_s=WAIT_S, shared=True) as shared,
        subscribe(endpoint, parts=list(PARTS), timeout_s=WAIT_S) as copied,
    ):
        wait_until(lambda: len(made.status()["topics"]) == 2 and made.wanted_parts() == frozenset(PARTS))
        for seq in range(3 * MOST_SLOTS):
            item = rich(seq)
            clouds.send(made, item, copied.topic)
            one, other = next(shared), next(copied)
            assert one.header.seq == other.header.seq == seq
            assert {part.codec for part in one.header.parts} == {"shared"}
            for name in PARTS:
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
                assert getattr(one, name).dtype == getattr(other, name).dtype
                assert not getattr(one, name).flags.writeable
        assert one.header.stats == other.header.stats
        assert shared.lost == copied.lost == 0


def test_the_basic_topic_has_the_configured_parts_in_shared_memory_too(endpoint: str) -> None:
    with (
        clouds.publisher(endpoint, parts=(*BASIC, "rgb")) as made,
        subscribe(endpoint, timeout_s=WAIT_S, shared=True) as stream,
    ):
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        made.offer(rich())
        cloud = next(stream)
    assert [part.name for part in cloud.header.parts] == [*BASIC, "rgb", "interpolated"]
    assert cloud.rgb is not None and cloud.interpolated is not None


def test_clouds_of_other_sizes_move_to_a_larger_file(endpoint: str, tmp_path: Path) -> None:
    with clouds.publisher(endpoint) as made, subscribe(endpoint, timeout_s=WAIT_S, shared=True) as stream:
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        for seq, size in enumerate([(32, 26), (160, 120), (32, 26), (400, 300)]):
            item = clouds.item(seq, size=size)
            made.offer(item)
            np.testing.assert_array_equal(next(stream).xyz, item.cloud.xyz)
        assert len(files(tmp_path)) == 1
    assert not files(tmp_path)


def test_a_restarted_publisher_is_read_from_its_own_memory(endpoint: str) -> None:
    with subscribe(endpoint, timeout_s=WAIT_S, shared=True) as stream:
        for seq in range(2):
            with clouds.publisher(endpoint, session=f"session-{seq}") as made:
                # ZeroMQ subscribes again only while its owner is waiting for messages, as a reader is.
                wait_until(lambda made=made: stream._clouds.poll(0.01) or made.status()["topics"])  # type: ignore[misc]
                made.offer(clouds.item(seq))
                cloud = next(stream)
            np.testing.assert_array_equal(cloud.xyz, clouds.item(seq).cloud.xyz)


def test_a_reader_never_gets_a_mixture_of_two_clouds(ring: SharedClouds) -> None:
    """Whatever the writer does meanwhile: whole contents of one number, or an error."""
    references: list[tuple[int, bytes]] = []
    ended, whole, refused = threading.Event(), 0, 0

    def write() -> None:
        for number in range(1500):
            references.append((number, ring.store({"xyz": np.full(12_000, number, np.uint32)})["xyz"]))
        ended.set()

    writer = threading.Thread(target=write)
    writer.start()
    memory, rng = SharedMemory(), np.random.default_rng(1)
    while not ended.is_set() or not whole:
        if references:
            number, reference = references[max(0, len(references) - 1 - int(rng.integers(0, 2 * MOST_SLOTS)))]
            try:
                found = read(reference, 48_000, memory).view(np.uint32)
            except OverwrittenError:
                refused += 1
            else:
                assert (found == number).all()
                whole += 1
    writer.join()
    memory.close()
    assert whole and refused


def test_what_was_overwritten_is_an_error(ring: SharedClouds) -> None:
    memory = SharedMemory()
    stored = [ring.store({"xyz": np.full(10, seq, np.uint8)})["xyz"] for seq in range(MOST_SLOTS + 2)]
    for seq, reference in enumerate(stored):
        if seq < 2:
            with pytest.raises(OverwrittenError, match="replaced by a newer cloud"):
                read(reference, 10, memory)
        else:
            assert (read(reference, 10, memory) == seq).all()
    memory.close()


def test_a_subscriber_of_every_cloud_counts_what_was_overwritten_as_lost(endpoint: str) -> None:
    count = MOST_SLOTS + 3
    with (
        clouds.publisher(endpoint) as made,
        subscribe(endpoint, timeout_s=WAIT_S, latest=False, shared=True) as stream,
    ):
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        for seq in range(count):
            clouds.send(made, clouds.item(seq), shared_topic("cloud/full"))
        wait_until(lambda: stream._clouds.poll(0.1))
        received = []
        while not received or received[-1] < count - 1:
            received.append(next(stream).header.seq)
        assert received == list(range(count - MOST_SLOTS, count))
        assert stream.lost == count - MOST_SLOTS


def test_without_room_clouds_come_through_the_socket_and_the_status_has_the_reason(
    endpoint: str, tmp_path: Path
) -> None:
    with (
        clouds.publisher(endpoint, shared_bytes=4096) as made,
        subscribe(endpoint, timeout_s=WAIT_S, shared=True) as stream,
    ):
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        made.offer(clouds.item(1))
        cloud = next(stream)
        assert {part.codec for part in cloud.header.parts} == {"none"}
        np.testing.assert_array_equal(cloud.xyz, clouds.item(1).cloud.xyz)
        assert "raise stream.shared_memory_mb" in made.status()["problem"]
    assert not files(tmp_path)


@pytest.mark.parametrize("options", [{"shared_bytes": 0}, {}])
def test_without_shared_memory_nothing_is_created(endpoint: str, tmp_path: Path, options: dict[str, int]) -> None:
    with clouds.publisher(endpoint if options else clouds.TCP, **options) as made:
        assert made.status()["shared"] is False
        topic = shared_topic("cloud/full")
        with Subscription(made.endpoints[0], "cloud/full", latest=True, timeout_s=WAIT_S) as stream:
            stream._clouds.socket.subscribe(topic)
            stream._clouds.socket.unsubscribe("cloud/full")
            wait_until(lambda: made.status()["topics"] == [topic])
            made.offer(clouds.item(1))
            np.testing.assert_array_equal(next(stream).xyz, clouds.item(1).cloud.xyz)
        assert "problem" not in made.status() and not files(tmp_path)


def test_fewer_slots_where_the_limit_is_near(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "s").touch()
    array = np.zeros(100_000, np.uint8)
    ring = SharedClouds([endpoint], limit_bytes=LEAST_SLOTS * 110_000)
    try:
        first = ring.store({"xyz": array})["xyz"]
        references = [ring.store({"xyz": array})["xyz"] for _ in range(LEAST_SLOTS)]
        memory = SharedMemory()
        assert all(not read(reference, 100_000, memory).any() for reference in references)
        with pytest.raises(OverwrittenError):
            read(first, 100_000, memory)
        memory.close()
        assert files(tmp_path)[0].stat().st_size <= LEAST_SLOTS * 110_000
    finally:
        ring.close()


def test_who_may_connect_may_read_and_nobody_else(endpoint: str, tmp_path: Path) -> None:
    with clouds.publisher(endpoint) as made, subscribe(endpoint, timeout_s=WAIT_S, shared=True) as stream:
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        made.offer(clouds.item(1))
        next(stream)
        (file,) = files(tmp_path)
        status, socket = file.stat(), (tmp_path / "s").stat()
        assert status.st_mode & 0o777 == 0o640 and (status.st_uid, status.st_gid) == (socket.st_uid, socket.st_gid)


def test_the_memory_of_a_daemon_that_was_killed_is_removed(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "s").touch()
    killed = SharedClouds([endpoint], limit_bytes=MEBIBYTE)
    killed.store({"xyz": np.zeros(10, np.uint8)})
    other = SharedClouds([f"ipc://{tmp_path}/other"], limit_bytes=MEBIBYTE)
    assert len(files(tmp_path)) == 1
    SharedClouds([endpoint], limit_bytes=MEBIBYTE).close()
    assert not files(tmp_path)
    other.close()
    killed.close()


def reference(path: Path | str, *, slot: Any = 0, number: Any = 1, at: Any = 8) -> bytes:
    return msgspec.json.encode({"file": str(path), "slot": slot, "number": number, "at": at})


def test_bad_references_are_named(tmp_path: Path) -> None:
    file, pipe, link = tmp_path / "file", tmp_path / "pipe", tmp_path / "link"
    file.write_bytes((1).to_bytes(8, "little") + bytes(56))
    os.mkfifo(pipe)
    link.symlink_to(file)
    memory = SharedMemory()
    assert not read(reference(file), 56, memory).any()
    for raw, text in (
        (b"", "reference to shared memory"),
        (b"\xff\xfe", "reference to shared memory"),
        (b"[" * 5000, "reference to shared memory"),
        (b" " * 10_000, "reference of 10000 bytes, limit 8192"),
        (reference(file, at=-1), "Expected `int` >= 0"),
        (reference(file, number=0), "Expected `int` >= 1"),
        (reference(file, slot="0"), "Expected `int`"),
        (reference(file, at=9), "lie beyond the 64 bytes"),
        (reference(file, slot=60), "lie beyond the 64 bytes"),
        (reference(file, at=1 << 62), "lie beyond the 64 bytes"),
        (reference(pipe), "is not a regular file"),
        (reference(tmp_path), "is not a regular file"),
    ):
        with pytest.raises(WireError, match=text):
            read(raw, 56, memory)
    for path in (tmp_path / "missing", link, "\0"):
        with pytest.raises(SharedMemoryError, match="subscribe with shared=False"):
            read(reference(path), 56, memory)
    with pytest.raises(OverwrittenError):
        read(reference(file, number=2), 56, memory)
    memory.close()


def test_where_the_memory_cannot_be_opened_clouds_are_copied_unless_it_was_demanded(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def elsewhere(_: SharedMemory, file: str, where: str) -> Any:
        raise SharedMemoryError(f"{where}: {file} does not exist here")

    monkeypatch.setattr(SharedMemory, "_opened", elsewhere)
    with (
        clouds.publisher(endpoint) as made,
        Subscription(endpoint, "cloud/full", latest=False, timeout_s=WAIT_S, shared=None) as stream,
        subscribe(endpoint, timeout_s=WAIT_S, shared=True) as demanding,
    ):
        wait_until(lambda: made.has_subscribers(shared_topic("cloud/full")))
        for seq in range(3):  # several that refer to the memory before the reader notices
            clouds.send(made, clouds.item(seq), shared_topic("cloud/full"))
        with pytest.raises(SharedMemoryError):
            next(demanding)
        wait_until(lambda: stream._take() is None and made.has_subscribers("cloud/full"))
        clouds.send(made, clouds.item(3), shared_topic("cloud/full"))
        cloud = next(stream)
        assert cloud.header.seq == 3 and {part.codec for part in cloud.header.parts} == {"none"}
    assert caplog.text.count("clouds are copied through the socket instead") == 1


def test_shared_memory_is_for_local_sockets_and_uncompressed_clouds(endpoint: str) -> None:
    with pytest.raises(FringedError, match=r"ipc://PATH"):
        subscribe("tcp://127.0.0.1:5555", shared=True)
    with pytest.raises(FringedError, match="'cloud/depth' is not in shared memory"):
        subscribe(endpoint, topic="cloud/depth", shared=True)


@pytest.mark.parametrize("topic", ["cloud/full", "cloud/parts/xyz/", "cloud/parts/xyz,gray,rgb/"])
def test_topics_of_shared_clouds_and_back(topic: str) -> None:
    assert copied_topic(shared_topic(topic)) == topic
    assert len(shared_topic("cloud/parts/" + ",".join(PARTS) + "/")) <= 64


@pytest.mark.parametrize("topic", ["cloud/full", "cloud/shared/", "cloud/shared/rgb,xyz/", "cloud/shared/full", ""])
def test_other_topics_are_not_shared(topic: str) -> None:
    assert copied_topic(topic) is None


def test_a_reference_is_what_the_protocol_documents() -> None:
    made = msgspec.json.encode(Reference(file="/run/fringed/x", slot=4096, number=3, at=8192))
    assert msgspec.json.decode(made) == {"file": "/run/fringed/x", "slot": 4096, "number": 3, "at": 8192}
