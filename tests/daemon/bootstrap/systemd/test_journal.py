"""Log lines with fields, as the journal receives them."""

from __future__ import annotations

import array
import logging
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.bootstrap.systemd.journal import JournalHandler, encode, started_by_systemd


class Journal:
    """A journal for tests: reads a record from the datagram or from the attached file."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.setblocking(False)

    def read(self) -> dict[str, str]:
        data, ancillary, _, _ = self.socket.recvmsg(1 << 16, socket.CMSG_SPACE(4))
        for _, _, sent in ancillary:
            (handle,) = array.array("i", sent[:4])
            os.lseek(handle, 0, os.SEEK_SET)
            with os.fdopen(handle, "rb") as file:
                data = file.read()
        return decode(data)


def decode(data: bytes) -> dict[str, str]:
    """Parse the native protocol like the journal."""
    fields = {}
    while data:
        line, _, rest = data.partition(b"\n")
        if b"=" in line:
            name, _, value = line.partition(b"=")
            data = rest
        else:
            name, (length,) = line, struct.unpack("<Q", rest[:8])
            value, data = rest[8 : 8 + length], rest[9 + length :]
        fields[name.decode()] = value.decode()
    return fields


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(tmp_path / "journal")
    yield made
    made.socket.close()


@pytest.fixture
def log(tmp_path: Path) -> Iterator[logging.Logger]:
    logger = logging.getLogger("fringed.test-journal")
    logger.propagate = False
    handler = JournalHandler(tmp_path / "journal", fallback=Beside())
    handler.fields.update(session="abc", device="rig-01")
    logger.addHandler(handler)
    yield logger
    logger.removeHandler(handler)
    handler.close()


def handler_of(log: logging.Logger) -> JournalHandler:
    return next(handler for handler in log.handlers if isinstance(handler, JournalHandler))


class Beside(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def test_a_line_carries_session_device_and_its_own_fields(journal: Journal, log: logging.Logger) -> None:
    log.warning("camera %s is lost", "left", extra={"side": "left", "reason": "unplugged"})
    fields = journal.read()
    assert fields["MESSAGE"] == "camera left is lost" and fields["PRIORITY"] == "4"
    assert fields["FRINGED_SESSION"] == "abc" and fields["FRINGED_DEVICE"] == "rig-01"
    assert fields["FRINGED_SIDE"] == "left" and fields["FRINGED_REASON"] == "unplugged"
    assert fields["SYSLOG_IDENTIFIER"] == "fringed" and fields["LOGGER"] == "fringed.test-journal"
    assert fields["CODE_FILE"] == __file__


@pytest.mark.parametrize(("level", "priority"), [("debug", "7"), ("info", "6"), ("error", "3"), ("critical", "2")])
def test_levels_become_priorities(journal: Journal, log: logging.Logger, level: str, priority: str) -> None:
    log.setLevel(logging.DEBUG)
    getattr(log, level)("x")
    assert journal.read()["PRIORITY"] == priority


def test_a_traceback_is_one_entry(journal: Journal, log: logging.Logger) -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError:
        log.exception("it failed")
    message = journal.read()["MESSAGE"]
    assert message.startswith("it failed\nTraceback") and message.endswith("two\nlines")


def test_a_line_too_long_for_a_datagram_is_sent_as_a_file(journal: Journal, log: logging.Logger) -> None:
    log.info("%s", "x" * 900_000)
    assert journal.read()["MESSAGE"] == "x" * 900_000


def test_without_a_journal_the_lines_go_to_the_fallback(log: logging.Logger) -> None:
    log.info("hello")
    beside = handler_of(log)._fallback
    assert isinstance(beside, Beside) and beside.lines == ["hello"]


def test_a_journal_that_does_not_read_loses_lines_without_blocking(journal: Journal, log: logging.Logger) -> None:
    while not handler_of(log).lost:
        log.info("x")
    assert journal.read()["MESSAGE"] == "x"


@settings(deadline=None, max_examples=50)
@given(st.dictionaries(st.text("ABCDEFG_", min_size=1, max_size=20), st.text(), max_size=5))
def test_encoded_records_are_read_back_unchanged(fields: dict[str, str]) -> None:
    expected = {name: value.encode("utf-8", "replace").decode() for name, value in fields.items()}
    assert decode(encode(fields)) == expected


def test_systemd_is_detected_by_device_and_inode_of_standard_error(tmp_path: Path) -> None:
    handle = os.open(tmp_path / "stream", os.O_CREAT | os.O_WRONLY)
    there = os.fstat(handle)
    assert started_by_systemd({"JOURNAL_STREAM": f"{there.st_dev}:{there.st_ino}"}, handle)
    assert not started_by_systemd({"JOURNAL_STREAM": f"{there.st_dev}:{there.st_ino + 1}"}, handle)
    assert not started_by_systemd({}, handle)
    os.close(handle)
    assert not started_by_systemd({"JOURNAL_STREAM": "1:2"}, handle)
