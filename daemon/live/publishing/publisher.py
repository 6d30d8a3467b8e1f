"""The publisher: one thread that owns the XPUB socket and never delays the live path.

Producers put their data into slots (clouds and status: one slot, the newest wins; log lines: a short queue) and wake
the thread. A message is made only while its topic has subscribers. A new subscriber gets the ``meta/`` messages at
once, before anything else but one message: the queue of every subscriber has room for them beside other messages.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import zmq

from daemon.common.clock import SystemClock
from daemon.common.counters import Percentiles
from daemon.common.heartbeat import Heartbeat
from daemon.config.rig_config import RigConfig
from daemon.live.items import CloudItem, Item
from daemon.live.publishing import messages
from daemon.live.publishing.cloud_topics import CloudTopics, load_codecs
from daemon.live.publishing.log_handler import StreamHandler
from daemon.live.publishing.messages import Frames, Origin
from daemon.live.publishing.shared_clouds import SharedClouds
from daemon.live.publishing.stream_socket import StreamSocket
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock
from fringed.parts import BASIC
from pipeline.rig.calibration import Calibration

log = logging.getLogger("fringed.stream")

MAX_PREVIEW_HZ = 10.0
_LOG_QUEUE = 64
_JOIN_S = 5.0
_IDLE_MS, _TURN_S = 1000, 15.0  # of waiting; longest time of a turn


class Publisher:
    """A sink for clouds; bound and running once it is made.

    Args:
        endpoints: to bind; port ``*`` or 0 becomes a free one, see :attr:`endpoints`.
        device, session, identity: in every header, the last as ``calibration``.
        calibration: gives the rays of the left camera; calibration_data: the bytes of its file.
        config: of the rig, plain values.
        preview_hz: previews per second, at most 10; 0 = none.
        parts: of ``cloud/full``.
        shared_bytes: limit of the memory for subscribers on this machine; 0 = none.

    Raises:
        DaemonError: an endpoint that cannot be bound.
    """

    def __init__(
        self,
        endpoints: Iterable[str],
        *,
        device: str,
        session: str,
        calibration: Calibration,
        calibration_data: bytes,
        identity: str,
        config: dict[str, Any],
        preview_hz: float = 2.0,
        parts: Sequence[str] = BASIC,
        shared_bytes: int = 1 << 28,
        clock: Clock | None = None,
    ) -> None:
        self._clock = clock or SystemClock()
        self._origin = Origin(device, session, identity)
        retained = messages.retained(
            self._origin,
            calibration=calibration_data,
            rays=calibration.left.rays(),
            config=config,
            t_ns=self._clock.realtime_ns(),
        )
        self._republish: set[str] = set()
        self._preview_ns = _period_ns(preview_hz)
        self._preview_due_ns = 0
        # Re-entrant: a signal handler that logs may interrupt the very thread that holds it.
        self._lock = threading.RLock()
        self._cloud: tuple[CloudItem, Origin] | None = None
        self._status: dict[str, Any] | None = None
        self._lines: deque[tuple[int, str, str, str]] = deque(maxlen=_LOG_QUEUE)
        self._full_parts = tuple(parts)
        self._dropped = 0
        self._latency_ms = Percentiles()
        self._line_count = self._status_count = 0
        self._problem = ""
        self._closing = False
        self.heartbeat = Heartbeat()
        self._socket = StreamSocket(endpoints, retained=retained, subscribed=lambda all_: self._topics.note(all_))
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        #: What was bound, with real port numbers.
        self.endpoints = self._socket.endpoints
        try:
            shared = SharedClouds(self.endpoints, limit_bytes=shared_bytes)
        except BaseException:
            self._release()
            raise
        self._shared = shared.available
        self._topics = CloudTopics(shared)
        self._handler = StreamHandler(self._publish_line)
        logging.getLogger("fringed").addHandler(self._handler)
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)
        self._thread.start()
        log.info("stream at %s", ", ".join(self.endpoints))

    def offer(self, item: Item) -> bool:
        """Take a cloud; one that still waits is dropped for it and counted."""
        if isinstance(item, CloudItem):
            with self._lock:
                if self._closing:
                    return False
                self._dropped += self._cloud is not None
                self._cloud = (item, self._origin)
                self._wake()
        return True

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare other ``meta/`` messages; clouds carry the calibration that they were made with."""
        origin = Origin(self._origin.device, self._origin.session, rig.identity)
        retained = messages.retained(
            origin,
            calibration=rig.calibration_data,
            rays=rig.calibration.left.rays(),
            config=config.model_dump(mode="json"),
            t_ns=self._clock.realtime_ns(),
        )

        # Only changed messages: a burst must fit into a subscriber's queue.
        new = {topic for topic, frames in retained.items() if messages.differ(frames, self._socket.retained[topic])}
        if origin != self._origin:
            new |= set(retained) - {"meta/schema"}

        def commit() -> None:
            with self._lock:
                self._origin, self._socket.retained = origin, retained
                self._republish |= new
                self._preview_ns = _period_ns(config.stream.preview_hz)
                self._full_parts = tuple(config.outputs.parts)
                self._wake()

        return commit

    def publish_status(self, status: dict[str, Any]) -> None:
        """Send the status; never blocks."""
        with self._lock:
            self._status = status
            self._wake()

    def has_subscribers(self, topic: str) -> bool:
        """Whether a topic has subscribers now."""
        return self._socket.has_subscribers(topic)

    def wanted_parts(self) -> frozenset[str]:
        """Parts that subscribers ask for by topic."""
        return self._topics.wanted_parts()

    def status(self) -> dict[str, Any]:
        """Endpoints, messages sent by topic, clouds replaced by newer ones before they were sent.

        ``latency_ms``: from the arrival of the pair's second frame to the call that sends its cloud.
        """
        values: dict[str, Any] = {
            "endpoints": self.endpoints,
            "shared": self._shared,
            "sent": self._socket.sent.snapshot(),
            "dropped": self._dropped,
            "latency_ms": self._latency_ms.summary(),
            "topics": sorted(prefix.decode(errors="replace") for prefix in self._socket.prefixes),
        }
        texts = dict(self._socket.problems) | {"cloud/shared": self._topics.problem, "thread": self._problem}
        problems = [f"{topic}: {text}" for topic, text in texts.items() if text]
        return values | ({"problem": "; ".join(problems)} if problems else {})

    def close(self) -> None:
        """Send what is queued and unbind; may be called twice."""
        logging.getLogger("fringed").removeHandler(self._handler)
        with self._lock:
            self._closing = True
            self._wake()
        self._thread.join(_JOIN_S)

    def _wake(self) -> None:
        """With the lock held, so that the descriptor cannot be closed, and its number reused, meanwhile."""
        if self._wake_fd >= 0:
            os.eventfd_write(self._wake_fd, 1)

    def _publish_line(self, t_ns: int, level: str, logger: str, text: str) -> None:
        with self._lock:
            self._lines.append((t_ns, level, logger, text))
            self._wake()

    def _run(self) -> None:
        with suppress(Exception):  # the first message reports the error
            load_codecs()
        poller = zmq.Poller()
        poller.register(self._socket.socket, zmq.POLLIN)
        poller.register(self._wake_fd, zmq.POLLIN)
        try:
            while not self._closing:
                self.heartbeat.expect(_TURN_S)
                events = dict(poller.poll(_IDLE_MS))
                if self._wake_fd in events:
                    os.eventfd_read(self._wake_fd)
                self._socket.serve_subscriptions()
                self._send_waiting()
            self._send_waiting()  # the last status
        except Exception as error:
            self._problem = f"it ended: {error}"
            log.exception("the stream's thread ended")
        finally:
            self.heartbeat.rest()
            with self._lock:
                self._closing = True
                self._topics.close()
                self._release()

    def _release(self) -> None:
        self._socket.close()
        os.close(self._wake_fd)
        self._wake_fd = -1

    def _send_waiting(self) -> None:
        with self._lock:
            cloud, self._cloud = self._cloud, None
            republish, self._republish = self._republish, set()
            status, self._status = self._status, None
            lines = list(self._lines)
            self._lines.clear()
        old = cloud is not None and cloud[1] is not self._origin
        if cloud is not None and old:
            self._send_cloud(*cloud)
        for topic in sorted(topic for topic in republish if self.has_subscribers(topic)):
            self._socket.send(topic, self._socket.retained[topic])
        if cloud is not None and not old:
            self._send_cloud(*cloud)
        send = self._socket.send_if_subscribed
        if status is not None:
            self._status_count += 1
            send("status", lambda: messages.status(self._origin, status, seq=self._status_count))
        for t_ns, level, logger, text in lines:
            self._line_count += 1
            send("log", lambda line=(t_ns, level, logger, text): self._line(*line))  # type: ignore[misc]

    def _send_cloud(self, item: CloudItem, origin: Origin) -> None:
        sent = False
        for topic, make in self._topics.makers(origin, item, self._full_parts).items():
            if self._socket.send_if_subscribed(topic, make) and not sent:
                sent = True
                self._latency_ms.note((self._clock.realtime_ns() - item.t_arrived_ns) / 1e6)
        now_ns = self._clock.monotonic_ns()
        if self._preview_ns is not None and now_ns >= self._preview_due_ns and self.has_subscribers("preview"):
            self._preview_due_ns = now_ns + self._preview_ns
            from daemon.live.publishing.preview import preview

            self._socket.send_if_subscribed("preview", lambda: preview(origin, item))

    def _line(self, t_ns: int, level: str, logger: str, text: str) -> Frames:
        return messages.log(self._origin, seq=self._line_count, t_ns=t_ns, level=level, logger=logger, text=text)


def _period_ns(preview_hz: float) -> int | None:
    return round(1e9 / min(preview_hz, MAX_PREVIEW_HZ)) if preview_hz > 0 else None
