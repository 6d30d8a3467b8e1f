"""Subscribe to the clouds of a daemon: ``for cloud in subscribe("tcp://rig:5555"): ...``."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import zmq
from numpy.typing import NDArray

from fringed import wire
from fringed.control.arguments import checked_timeout_or_none
from fringed.control.connection import listener_problem
from fringed.errors import ArgumentError, OverwrittenError, SharedMemoryError, SilenceError, WireError
from fringed.keys import Keys
from fringed.losses import Losses
from fringed.parts import BASIC, PARTS, parts_of, shared_topic, topic_of
from fringed.receiver import Receiver
from fringed.shared_memory import SharedMemory

DEFAULT_ENDPOINT = "tcp://127.0.0.1:5555"
TOPICS = ("cloud/full", "cloud/depth")

_LATEST_QUEUE, _EVERY_QUEUE = 2, 32
_REQUEST_AGAIN_S = 2.0
_WARN_S = 2.0

log = logging.getLogger("fringed.client")


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedCloud:
    """A received cloud on the left camera's pixel grid; the arrays are read-only.

    Args:
        header: sequence number, time, session, calibration and statistics.
        xyz: (H, W, 3) float32, mm, NaN where there is no point.
        gray: (H, W) uint8, the texture; None on ``cloud/depth``.
        sigma: (H, W) float32, mm, one standard deviation along the viewing ray; None on ``cloud/depth``.
        rgb: (H, W, 3) uint8, colour without fringes, linear; normals: (H, W, 3) float32, unit vectors towards the
            camera, NaN where unknown; interpolated: (H, W) bool, points that were filled in, not measured. All None
            unless they were asked for (``parts``) or the daemon adds them to every cloud.
    """

    header: wire.CloudHeader
    xyz: NDArray[np.float32]
    gray: NDArray[np.uint8] | None
    sigma: NDArray[np.float32] | None
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    interpolated: NDArray[np.bool_] | None = None

    @property
    def every(self) -> int:
        """Spacing of the measured pixels: 2 means every second row and column of the camera, under load."""
        return _every(self.header)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask of the pixels with a point, (H, W)."""
        return np.isfinite(self.xyz[..., 2])

    @property
    def points(self) -> NDArray[np.float32]:
        """The valid points, (N, 3), mm."""
        return self.xyz[self.valid]


class _Stream:
    """Common part of the blocking and the async subscription; receives messages, never waits."""

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
        header = message.header
        if not isinstance(header, wire.CloudHeader):
            raise WireError(f"{message.topic}: kind {header.kind!r}, expected 'cloud'")
        if self._parts is not None:
            cloud = full_cloud(message, self._parts)
        else:
            _check(message, {"z": ("<u2", (header.height, header.width))})
            if not self._rays_match(header):
                return None
            cloud = ReceivedCloud(header, _points(message, self._rays), None, None)
        self.received += 1
        return cloud

    def _rays_match(self, header: wire.CloudHeader) -> bool:
        """Return whether the received rays belong to this cloud; request them if not."""
        rays = self._rays
        if rays is not None and rays.header.calibration == header.calibration:
            return _rays_of(rays, header).shape[:2] == (header.height, header.width)
        now_s = time.monotonic()
        if self._meta is not None and now_s - self._requested_s > _REQUEST_AGAIN_S:
            self._requested_s = now_s
            self._meta.request_again("meta/rays")
        return False

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


class Subscription(_Stream):
    """Iterator over clouds, created by :func:`subscribe`."""

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> ReceivedCloud:
        """Wait for the newest cloud that was not yet returned (or the next one).

        Raises:
            SilenceError: none came within the time-out; another call continues to wait.
            WireError: a message violates the format; another call continues after it.
        """
        deadline_s = self._deadline_s()
        poller = zmq.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            poller.poll(_wait_ms(self._left_s(deadline_s)))
        return cloud

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncSubscription(_Stream):
    """Asynchronous iterator over clouds, created by :func:`asubscribe`."""

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> ReceivedCloud:
        """Wait like ``Subscription.__next__``, without blocking the event loop."""
        import zmq.asyncio

        deadline_s = self._deadline_s()
        poller = zmq.asyncio.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            await poller.poll(_wait_ms(self._left_s(deadline_s)))
        return cloud

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


def subscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    parts: Iterable[str] | None = None,
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
    shared: bool = False,
) -> Subscription:
    """Subscribe to the clouds of a daemon, for ``for`` and ``with``; it connects and reconnects by itself.

    Args:
        endpoint: ``tcp://HOST:PORT`` or ``ipc://PATH``.
        topic: ``cloud/full``, or ``cloud/depth`` for slow networks (points only; needs the package blosc2).
        parts: instead of a topic: what each cloud shall carry, ``xyz`` and any of ``gray``, ``sigma``, ``rgb``,
            ``normals``, ``interpolated``; the daemon computes colour and normals only for those who ask.
        latest: return the newest cloud and skip older ones; False: every cloud, within the limits of the queues.
        timeout_s: longest wait before SilenceError; None = no limit.
        keys: for a daemon on another machine: ``Keys.load("laptop.key", "server.pub")``.
        shared: for ``ipc://PATH``: read the clouds from the daemon's shared memory, which takes less of both programs'
            time than a copy through the socket; :meth:`fringed.Rig.clouds` does so by itself.
    """
    topic = topic if parts is None else topic_of(parts)
    return Subscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys, shared=shared)


def asubscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    parts: Iterable[str] | None = None,
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
    shared: bool = False,
) -> AsyncSubscription:
    """Subscribe like :func:`subscribe`, for ``async for`` and ``async with``."""
    topic = topic if parts is None else topic_of(parts)
    return AsyncSubscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys, shared=shared)


def full_cloud(message: wire.Message, parts: Iterable[str] = BASIC) -> ReceivedCloud:
    """Return the cloud in a message of ``cloud/full``, or of a topic that asks for parts.

    Args:
        parts: that it must have; what the daemon adds is checked as well.

    Raises:
        WireError: another kind of message, or a part that is missing or of another type or shape.
    """
    header, arrays = message.header, message.arrays
    if not isinstance(header, wire.CloudHeader):
        raise WireError(f"{message.topic}: kind {header.kind!r}, expected 'cloud'")
    grid, wanted = (header.height, header.width), set(parts)
    names = [name for name in PARTS if name in arrays or name in wanted]
    _check(message, {name: (PARTS[name][0], (*grid, *PARTS[name][1])) for name in names})
    values: dict[str, Any] = dict.fromkeys(PARTS) | {name: arrays[name] for name in names}
    if values["interpolated"] is not None:
        values["interpolated"] = values["interpolated"].view(np.bool_)
    return ReceivedCloud(header, **values)


def _wait_ms(left_s: float) -> int:
    """Wait at most a second, so that lost rays are requested again."""
    return max(1, round(1000 * min(left_s, 1.0)))


def _check(message: wire.Message, expected: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, (dtype, shape) in expected.items():
        array = message.arrays.get(name)
        if array is None or array.dtype.str != dtype or array.shape != shape:
            actual = "is missing" if array is None else f"is {array.dtype.str} {list(array.shape)}"
            raise WireError(f"{message.topic}: part {name!r} {actual}, expected {dtype} {list(shape)}")


def _every(header: wire.Header) -> int:
    every = header.stats.get("every", 1) if isinstance(header, wire.CloudHeader) else 1
    return every if isinstance(every, int) and every > 0 else 1


def _rays_of(rays: wire.Message, header: wire.Header) -> NDArray[np.float32]:
    """Return the rays of a cloud's pixels, (height, width, 2) if the calibrations match."""
    array, every = rays.arrays["rays"], _every(header)
    if isinstance(header, wire.CloudHeader) and array.shape[:2] != (header.height, header.width):
        return array[::every, ::every]
    return array


def _points(message: wire.Message, rays: wire.Message | None) -> NDArray[np.float32]:
    """Compute the points of a depth message: xyz = z * (rx, ry, 1), NaN where the stored number is 0."""
    part, stored = message.part("z"), message.arrays["z"]
    if rays is None or not isinstance(part.scale, float) or not isinstance(part.offset, float):
        raise WireError(f"{message.topic}: part 'z' needs scale and offset")
    z = stored * np.float32(part.scale) + np.float32(part.offset)
    z[stored == 0] = np.nan
    xyz = np.empty((*z.shape, 3), np.float32)
    np.multiply(_rays_of(rays, message.header), z[..., None], out=xyz[..., :2])
    xyz[..., 2] = z
    xyz.setflags(write=False)
    return xyz
