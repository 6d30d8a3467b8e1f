"""The daemon's side of the gate: a sink that starts the gate process, restarts it, and reports its status."""

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
from daemon.remote_access.gate_messages import GateConfig, GateStatus
from daemon.remote_access.key_watch import KeyWatch
from daemon.remote_access.link import Link
from drivers import child_process
from drivers.errors import DriverError

log = logging.getLogger("fringed.gate")

_START_S = 60.0
_SILENCE_S = 60.0  # a gate without a message for this long hangs and is replaced
_PAUSES_S = (0.5, 1.0, 2.0, 5.0)
_JOIN_S = 5.0
_POLL_S = 0.25  # a revoked key loses its connections within this time


class RemoteGate:
    """Runs the gate, through which other machines connect as their keys allow.

    Args:
        config: of the gate; store: the keys.

    Raises:
        DaemonError: keys that cannot be used, an address that cannot be bound.
    """

    heartbeat = None

    def __init__(self, config: GateConfig, store: KeyStore) -> None:
        self._config, self._keys = config, KeyWatch(store)
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._restarts = 0
        self._down = ""
        self._link, self._process, self._output = self._start()
        self._status = self._first_status()
        # After a restart the addresses must be the same, whatever port was free the first time.
        self._config = msgspec.structs.replace(config, stream=self._status.stream, control=self._status.control)
        for service, endpoints in (("stream", self._status.stream), ("control", self._status.control)):
            if endpoints:
                log.info(
                    "%s for other machines at %s, %d keys",
                    service,
                    ", ".join(endpoints),
                    len(self._keys.keyring.entries),
                )
        self._thread = threading.Thread(target=self._run, name="gate", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:  # noqa: ARG002 - the gate subscribes to the stream instead
        """Ignore an item."""
        return True

    @property
    def pid(self) -> int:
        """Id of the gate process now."""
        return self._process.pid

    def status(self) -> dict[str, Any]:
        """Return addresses, connections, and refusals by reason."""
        status, down = self._status, self._down
        values: dict[str, Any] = {
            "stream": status.stream,
            "control": status.control,
            "keys": len(self._keys.keyring.entries),
            "accepted": status.accepted,
            "connections": status.connections,
            "refused": status.refused,
            "last_refused": status.last,
            "cut": status.cut,
            "sent": status.sent,
            "skipped": status.skipped,
            "requests": status.requests,
            "memory_mb": status.memory_mb,
            "restarts": self._restarts,
        }
        problem = down or self._keys.problem
        return values | ({"problem": problem} if problem else {})

    def close(self) -> None:
        """End the gate; may be called twice."""
        self._closing.set()
        with self._lock:
            self._link.shut_down()
        self._thread.join(_JOIN_S)
        self._link.close()
        child_process.end(self._process, _JOIN_S)
        self._output.join(1.0)

    def _start(self) -> tuple[Link, subprocess.Popen[bytes], child_process.OutputReader]:
        ours, theirs = socket.socketpair()
        try:
            arguments = [str(theirs.fileno()), str(os.getpid())]
            process = child_process.start("daemon.remote_access.gate.process", arguments, pass_fds=[theirs.fileno()])
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        output = child_process.OutputReader(process, log, "gate-output")
        link = Link(ours)
        with suppress(OSError):  # it has ended; its output is reported when its first status does not come
            link.send(self._config)
            link.send(self._keys.keyring)
        return link, process, output

    def _first_status(self) -> GateStatus:
        """Return the first status of the gate that was just started."""
        try:
            status = self._receive(_START_S)
        except TimeoutError:
            status = None
        if status is not None and not status.failed:
            return status
        self._link.close()
        child_process.end(self._process, _JOIN_S if status is not None else 0.0)
        self._output.join(1.0)
        raise DaemonError(status.failed if status is not None else f"the gate does not start: {self._output.text()}")

    def _run(self) -> None:
        failures = 0
        while not self._closing.is_set():
            began_s = time.monotonic()
            reason = self._listen()
            if self._closing.is_set():
                return
            failures = failures + 1 if time.monotonic() - began_s < _SILENCE_S else 0
            self._down = f"no other machine can connect: {reason}; it is restarted"
            log.error("%s", self._down)
            self._restart(failures)

    def _listen(self) -> str:
        """Receive the gate's status and send it changed keys until it ends or falls silent; return the reason."""
        received_s = time.monotonic()
        while time.monotonic() - received_s < _SILENCE_S:
            try:
                status = self._receive(_POLL_S)
            except TimeoutError:
                pass
            else:
                if status is None:
                    break
                received_s = time.monotonic()
                if status.last != self._status.last:
                    log.warning("%s", status.last)
                self._status = status
            if self._keys.changed():
                with suppress(OSError):
                    self._link.send(self._keys.keyring)
        if self._closing.is_set():
            return ""
        exit_status = child_process.end(self._process, 1.0)
        self._output.join(1.0)
        return f"the gate ended with exit status {exit_status}: {self._output.text()}"

    def _receive(self, timeout_s: float) -> GateStatus | None:
        message = self._link.receive(timeout_s)
        try:
            return None if message is None else msgspec.json.decode(message, type=GateStatus)
        except msgspec.MsgspecError:
            return None

    def _restart(self, failures: int) -> None:
        while not self._closing.wait(_PAUSES_S[min(failures, len(_PAUSES_S) - 1)]):
            failures += 1
            try:
                link, process, output = self._start()
            except DriverError as error:
                self._down = f"no other machine can connect: {error}"
                continue
            with self._lock:
                self._link.close()
                self._link, self._process, self._output = link, process, output
                if self._closing.is_set():
                    link.shut_down()
                    return
            self._restarts += 1
            try:
                self._status = self._first_status()
            except DaemonError as error:
                self._down = f"no other machine can connect: {error}"
                continue
            self._down = ""
            return
