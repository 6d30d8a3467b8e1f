"""Common part of the blocking and the asynchronous subscription."""

from __future__ import annotations

import logging
import time
from typing import Any

import zmq

from fringed import wire
from fringed.control.arguments import checked_timeout_or_none
from fringed.control.connection import listener_problem
from fringed.errors import ArgumentError, OverwrittenError, SharedMemoryError, SilenceError
from fringed.keys import Keys
from fringed.parts import BASIC, parts_of, shared_topic
from fringed.shared_memory import SharedMemory
from fringed.stream.losses import Losses
from fringed.stream.received_cloud import ReceivedCloud, cloud_header, depth_cloud, full_cloud, rays_of
from fringed.stream.receiver import Receiver

TOPICS = ("cloud/full", "cloud/depth")

_LATEST_QUEUE, _EVERY_QUEUE = 2, 32
_REQUEST_AGAIN_S = 2.0
_WARN_S = 2.0

log = logging.getLogger("fringed.client")


class CloudStream:
    """Receives the clouds of a topic; never waits."""

    def __init__(
        self,
        endpoint: str,
        topic: str,
        *,
        latest: bool,
        timeout_s: float | None,
        keys: Keys | None = None,
        shared: bool | None = False,
    ) -> None:
        """Subscribe; with ``shared=None`` the clouds are copied where the memory cannot be opened."""
        self._parts = BASIC if topic == TOPICS[0] else parts_of(topic)
        if self._parts is None and topic not in TOPICS:
            raise ArgumentError(f"topic {topic!r} carries no clouds; choose {' or '.join(TOPICS)}, or name parts")
        self.topic, self.latest, self.timeout_s = topic, latest, checked_timeout_or_none(timeout_s)
        self._with_keys = keys is not None
        self.received = self.skipped = self._overwritten = 0
        self._warned = False
        self._losses = Losses()
        self._rays: wire.Message | None = None
        self._requested_s = time.monotonic()
        self._memory, self._may_copy = None if shared is False else SharedMemory(), shared is None
        if self._memory is not None and not endpoint.startswith("ipc://"):
            raise ArgumentError(f"endpoint {endpoint!r} with shared=True: shared memory needs ipc://PATH, the daemon's "
                                "socket on this machine")  # fmt: skip
        received = topic if self._memory is None else shared_topic(topic)
        self._clouds = Receiver(endpoint, [received], queue=_LATEST_QUEUE if latest else _EVERY_QUEUE, keys=keys)
        self._meta: Receiver | None = None
        if topic == "cloud/depth":
            # A socket of its own: clouds must never displace the rays in a short queue.
            self._meta = Receiver(endpoint, ["meta/rays"], queue=4, keys=keys)

    @property
    def lost(self) -> int:
        """Clouds that were triggered and not received: gaps in ``seq`` within a session, and what was overwritten."""
        return self._losses.count + self._overwritten

    def close(self) -> None:
        """Disconnect; may be called twice."""
        self._clouds.close()
        if self._meta is not None:
            self._meta.close()
        if self._memory is not None:
            self._memory.close()

    def _sockets(self) -> list[zmq.Socket[Any]]:
        return [self._clouds.socket] + ([self._meta.socket] if self._meta is not None else [])

    def _take(self) -> ReceivedCloud | None:
        """Return the newest (or the next) received cloud, if any."""
        self._take_rays()
        frames = self._clouds.take()
        while frames is not None:
            _, header = wire.decode_header(frames)
            self._losses.add(header.session, header.seq)
            newer = self._clouds.take() if self.latest else None
            if newer is None:
                break
            self.skipped += 1
            frames = newer
        if frames is None:
            return None
        try:
            return self._cloud(wire.decode(frames, memory=self._memory))
        except OverwrittenError:
            self._overwritten += 1
        except SharedMemoryError as error:
            if not self._may_copy:
                raise
            log.warning("%s; clouds are copied through the socket instead", error)
            self._copy_instead()
        return self._take()

    def _copy_instead(self) -> None:
        """Subscribe to the same clouds without shared memory."""
        self._clouds.socket.subscribe(self.topic)
        self._clouds.socket.unsubscribe(shared_topic(self.topic))
        self._may_copy = False

    def _take_rays(self) -> None:
        while self._meta is not None and (frames := self._meta.take()) is not None:
            message = wire.decode(frames)
            if "rays" in message.arrays and message.arrays["rays"].shape[2:] == (2,):
                self._rays = message

    def _cloud(self, message: wire.Message) -> ReceivedCloud | None:
        if self._parts is not None:
            cloud: ReceivedCloud | None = full_cloud(message, self._parts)
        else:
            cloud = depth_cloud(message, self._rays_for(cloud_header(message)))
        self.received += cloud is not None
        return cloud

    def _rays_for(self, header: wire.CloudHeader) -> wire.Message | None:
        """Return the received rays if they belong to this cloud; request them if not."""
        rays = self._rays
        if rays is not None and rays.header.calibration == header.calibration:
            return rays if rays_of(rays, header).shape[:2] == (header.height, header.width) else None
        now_s = time.monotonic()
        if self._meta is not None and now_s - self._requested_s > _REQUEST_AGAIN_S:
            self._requested_s = now_s
            self._meta.request_again("meta/rays")
        return None

    def _silence(self) -> SilenceError:
        hint = ", does it allow this key, and is that its server key?" if self._with_keys else "?"
        problem = listener_problem(self._clouds.endpoint)
        if problem:
            hint = f"? {problem}"
        return SilenceError(
            f"no {self.topic} from {self._clouds.endpoint} within {self.timeout_s} s; is a daemon running{hint}"
        )

    def _deadline_s(self) -> float:
        self._waiting_s = time.monotonic()
        return float("inf") if self.timeout_s is None else time.monotonic() + self.timeout_s

    def _left_s(self, deadline_s: float) -> float:
        """Return the rest of the time-out; a wait without one is logged, once, when nothing listens there."""
        now_s = time.monotonic()
        if deadline_s <= now_s:
            raise self._silence()
        if not (self.timeout_s or self._warned or self.received) and now_s - self._waiting_s > _WARN_S:
            self._warned = True
            if problem := listener_problem(self._clouds.endpoint):
                log.warning("no %s from %s: %s; waiting for a daemon", self.topic, self._clouds.endpoint, problem)
        return deadline_s - now_s


def wait_ms(left_s: float) -> int:
    """Wait at most a second, so that lost rays are requested again."""
    return max(1, round(1000 * min(left_s, 1.0)))
