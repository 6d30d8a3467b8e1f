"""The gate as the daemon sees it: a sink that takes nothing, starts the gate's process, and tells how it goes."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import threading
import time
from contextlib import suppress
from typing import Any

import msgspec

from daemon.common.errors import DaemonError
from daemon.keys.key_store import KeyStore
from daemon.live.items import Item
from daemon.remote_access.gate_messages import Order, Told
from daemon.remote_access.key_watch import KeyWatch
from daemon.remote_access.link import Link
from drivers import child_process
from drivers.errors import DriverError

log = logging.getLogger("fringed.gate")

_START_S = 60.0
_SILENCE_S = 60.0  # a gate that says nothing for so long hangs, and is replaced
_PAUSES_S = (0.5, 1.0, 2.0, 5.0)
_JOIN_S = 5.0
_LOOK_S = 0.25  # so soon does a revoked key lose its connections


class RemoteGate:
    """Lets other machines in, as far as their keys allow.

    Args:
        order: what to guard; store: the keys.

    Raises:
        DaemonError: keys that cannot be used, an address that cannot be bound.
    """

    def __init__(self, order: Order, store: KeyStore) -> None:
        self._order, self._keys = order, KeyWatch(store)
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._restarts = 0
        self._down = ""
        self._link, self._process, self._prints = self._start()
        self._told = self._first()
        # After a restart the addresses must be the same, whatever port was free the first time.
        self._order = msgspec.structs.replace(order, stream=self._told.stream, control=self._told.control)
        for service, endpoints in (("stream", self._told.stream), ("control", self._told.control)):
            if endpoints:
                log.info(
                    "%s for other machines at %s, %d keys",
                    service,
                    ", ".join(endpoints),
                    len(self._keys.keyring.entries),
                )
        self._thread = threading.Thread(target=self._run, name="gate", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:  # noqa: ARG002 - it reads the stream itself, like any subscriber
        """Take nothing."""
        return True

    @property
    def pid(self) -> int:
        """Of the gate's process now."""
        return self._process.pid

    def status(self) -> dict[str, Any]:
        """Where it listens, who came, who was refused and why."""
        told, down = self._told, self._down
        values: dict[str, Any] = {
            "stream": told.stream,
            "control": told.control,
            "keys": len(self._keys.keyring.entries),
            "accepted": told.accepted,
            "connections": told.connections,
            "refused": told.refused,
            "last_refused": told.last,
            "cut": told.cut,
            "sent": told.sent,
            "skipped": told.skipped,
            "requests": told.requests,
            "memory_mb": told.memory_mb,
            "restarts": self._restarts,
        }
        problem = down or self._keys.problem
        return values | ({"problem": problem} if problem else {})

    def close(self) -> None:
        """Let nobody in any more; may be called twice."""
        self._closing.set()
        with self._lock:
            self._link.hang_up()
        self._thread.join(_JOIN_S)
        self._link.close()
        child_process.end(self._process, _JOIN_S)
        self._prints.join(1.0)

    def _start(self) -> tuple[Link, subprocess.Popen[bytes], child_process.Prints]:
        ours, theirs = socket.socketpair()
        try:
            arguments = [str(theirs.fileno()), str(os.getpid())]
            process = child_process.start("daemon.remote_access.gate.process", arguments, pass_fds=[theirs.fileno()])
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        prints = child_process.Prints(process, log, "gate-prints")
        link = Link(ours)
        with suppress(OSError):  # it has ended; what it printed is told when its first word does not come
            link.say(self._order)
            link.say(self._keys.keyring)
        return link, process, prints

    def _first(self) -> Told:
        """The first word of the gate that was just started."""
        try:
            told = self._word(_START_S)
        except TimeoutError:
            told = None
        if told is not None and not told.failed:
            return told
        self._link.close()
        child_process.end(self._process, _JOIN_S if told is not None else 0.0)
        self._prints.join(1.0)
        raise DaemonError(told.failed if told is not None else f"the gate does not start: {self._prints.text()}")

    def _run(self) -> None:
        failures = 0
        while not self._closing.is_set():
            began_s = time.monotonic()
            why = self._listen()
            if self._closing.is_set():
                return
            failures = failures + 1 if time.monotonic() - began_s < _SILENCE_S else 0
            self._down = f"no other machine can connect: {why}; it is started again"
            log.error("%s", self._down)
            self._begin_again(failures)

    def _listen(self) -> str:
        """Hear what the gate tells, and tell it of other keys, until it ends or falls silent; the reason."""
        heard_s = time.monotonic()
        while time.monotonic() - heard_s < _SILENCE_S:
            try:
                told = self._word(_LOOK_S)
            except TimeoutError:
                pass
            else:
                if told is None:
                    break
                heard_s = time.monotonic()
                if told.last != self._told.last:
                    log.warning("%s", told.last)
                self._told = told
            if self._keys.changed():
                with suppress(OSError):
                    self._link.say(self._keys.keyring)
        if self._closing.is_set():
            return ""
        status = child_process.end(self._process, 1.0)
        self._prints.join(1.0)
        return f"the gate ended with exit status {status}: {self._prints.text()}"

    def _word(self, timeout_s: float) -> Told | None:
        word = self._link.next(timeout_s)
        try:
            return None if word is None else msgspec.json.decode(word, type=Told)
        except msgspec.MsgspecError:
            return None

    def _begin_again(self, failures: int) -> None:
        while not self._closing.wait(_PAUSES_S[min(failures, len(_PAUSES_S) - 1)]):
            failures += 1
            try:
                link, process, prints = self._start()
            except DriverError as error:
                self._down = f"no other machine can connect: {error}"
                continue
            with self._lock:
                self._link.close()
                self._link, self._process, self._prints = link, process, prints
                if self._closing.is_set():
                    link.hang_up()
                    return
            self._restarts += 1
            try:
                self._told = self._first()
            except DaemonError as error:
                self._down = f"no other machine can connect: {error}"
                continue
            self._down = ""
            return
