"""Log lines with fields of their own, in the journal's native protocol.

Every line carries FRINGED_SESSION and FRINGED_DEVICE, and those of FRINGED_SIDE, FRINGED_REASON, FRINGED_TAKE and
FRINGED_SEQ that it was logged with (``extra``).
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import socket
import struct
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path

SOCKET = Path("/run/systemd/journal/socket")
EXTRA = "side", "reason", "take", "seq"
_MAX_BYTES = 1 << 20  # of one line, its traceback included
_TIMEOUT_S = 0.25
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))


def started_by_systemd(environ: Mapping[str, str], descriptor: int = 2) -> bool:
    """Whether standard error goes to the journal: JOURNAL_STREAM names its device and inode."""
    try:
        stat = os.fstat(descriptor)
    except OSError:
        return False
    return environ.get("JOURNAL_STREAM", "") == f"{stat.st_dev}:{stat.st_ino}"


class JournalHandler(logging.Handler):
    """Sends records to the journal, or to ``fallback`` where there is none.

    A journal that does not read delays the caller for a moment only: the line is lost and counted.

    ``fields`` stand in every line, ``{"session": ...}`` as FRINGED_SESSION.

    Args:
        path: of the journal's socket; fallback: takes the lines where there is none.
    """

    def __init__(self, path: Path = SOCKET, *, fallback: logging.Handler | None = None) -> None:
        super().__init__()
        self.fields: dict[str, str] = {}
        self.lost = 0
        self._path, self._fallback = str(path), fallback
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.settimeout(_TIMEOUT_S)

    def emit(self, record: logging.LogRecord) -> None:
        """Send one record."""
        try:
            self._send(encode(fields_of(record) | _prefixed(self.fields)))
        except TimeoutError:
            self.lost += 1
        except OSError:
            if self._fallback is not None:
                self._fallback.handle(record)
        except Exception:
            self.handleError(record)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        super().close()

    def _send(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, socket.MSG_NOSIGNAL, self._path)
        except OSError as error:
            if error.errno not in (errno.EMSGSIZE, errno.ENOBUFS):
                raise
            self._send_file(data)  # too long for a datagram

    def _send_file(self, data: bytes) -> None:
        """A sealed file without a name, as sd_journal_send does it."""
        handle = os.memfd_create("journal", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            with os.fdopen(handle, "wb", closefd=False) as file:
                file.write(data)
            fcntl.fcntl(handle, fcntl.F_ADD_SEALS, 0xF)
            ancillary = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, struct.pack("i", handle))]
            self._socket.sendmsg([b""], ancillary, socket.MSG_NOSIGNAL, self._path)
        finally:
            os.close(handle)


def fields_of(record: logging.LogRecord) -> dict[str, str]:
    """The journal's fields of a record."""
    fields = {
        "MESSAGE": _message(record),
        "PRIORITY": str(next((number for level, number in _PRIORITIES if record.levelno >= level), 7)),
        "SYSLOG_IDENTIFIER": "fringed",
        "LOGGER": record.name,
        "THREAD_NAME": record.threadName or "",
        "CODE_FILE": record.pathname,
        "CODE_LINE": str(record.lineno),
        "CODE_FUNC": record.funcName or "",
    }
    # logging stores what a line was logged with (``extra``) as attributes of its record.
    return fields | _prefixed({name: str(value) for name, value in vars(record).items() if name in EXTRA})


def encode(fields: Mapping[str, str]) -> bytes:
    """The native protocol: ``NAME=value``, or the name, a length of 8 bytes and the value where that has lines."""
    return b"".join(_encoded(fields))


def _encoded(fields: Mapping[str, str]) -> Iterator[bytes]:
    for name, value in fields.items():
        data = value.encode("utf-8", "replace")[:_MAX_BYTES]
        if b"\n" in data:
            yield b"%s\n%s%s\n" % (name.encode(), struct.pack("<Q", len(data)), data)
        else:
            yield b"%s=%s\n" % (name.encode(), data)


def _message(record: logging.LogRecord) -> str:
    text = record.getMessage()
    return f"{text}\n{''.join(traceback.format_exception(*record.exc_info)).rstrip()}" if record.exc_info else text


def _prefixed(fields: Mapping[str, str]) -> dict[str, str]:
    return {f"FRINGED_{name.upper()}": value for name, value in fields.items()}
