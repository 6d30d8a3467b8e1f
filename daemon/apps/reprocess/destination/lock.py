"""The lock of a destination: two runs never write into one at the same time.

On a mounted file system it is a lock of the operating system, which ends with the process. An object store has none:
there a file with the owner's name is renewed as long as the run lasts, and is valid for two minutes after that.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.apps.reprocess.locations import is_local, read_if_there
from daemon.common.errors import DaemonError

NAME = ".reprocess.lock"
VALID_S = 120.0
_RENEW_S = 30.0


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Hold the lock of a destination.

    Raises:
        DaemonError: another run holds it.
    """
    with _local(root) if is_local(root) else _remote(root):
        yield


def _owner() -> dict[str, object]:
    return {"host": socket.gethostname(), "process": os.getpid(), "id": uuid.uuid4().hex, "time": time.time()}


def _refusal(root: Path, owner: object) -> DaemonError:
    who = "another run"
    if isinstance(owner, dict):
        who = f"process {owner.get('process')} on {owner.get('host')}"
    return DaemonError(f"{root}: {who} is reprocessing into this destination; wait for its end, or give another --out")


@contextmanager
def _local(root: Path) -> Iterator[None]:
    root.mkdir(parents=True, exist_ok=True)
    with (root / NAME).open("a+b") as file:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            raise _refusal(root, _parsed(file.read())) from None
        except OSError as error:
            raise DaemonError(
                f"{root}: this file system supports no locks ({error.strerror}); mount it with locks"
            ) from error
        file.truncate(0)
        file.write(json.dumps(_owner()).encode())
        file.flush()
        yield


@contextmanager
def _remote(root: Path) -> Iterator[None]:
    place, mine = root / NAME, _owner()
    held = _parsed(read_if_there(place) or b"")
    if isinstance(held, dict) and time.time() - float(held.get("time", 0)) < VALID_S:
        raise _refusal(root, held)
    place.write_bytes(json.dumps(mine).encode())
    now = _parsed(read_if_there(place) or b"")
    if not isinstance(now, dict) or now.get("id") != mine["id"]:
        raise _refusal(root, now)
    ended = threading.Event()

    def renew() -> None:
        while not ended.wait(_RENEW_S):
            with suppress(Exception):  # the next renewal may succeed
                place.write_bytes(json.dumps(mine | {"time": time.time()}).encode())

    thread = threading.Thread(target=renew, name="reprocess-lock", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        with suppress(Exception):
            place.unlink()


def _parsed(data: bytes) -> object:
    try:
        return json.loads(data)
    except ValueError:
        return None
