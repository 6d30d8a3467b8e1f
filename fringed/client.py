"""Subscribe to the clouds of a daemon: ``for cloud in subscribe("tcp://rig:5555"): ...``."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import zmq
from numpy.typing import NDArray

from fringed import wire
from fringed.errors import FringedError, SilenceError, WireError
from fringed.keys import Keys
from fringed.losses import Losses
from fringed.receiver import Receiver

DEFAULT_ENDPOINT = "tcp://127.0.0.1:5555"
TOPICS = ("cloud/full", "cloud/depth")

_LATEST_QUEUE, _EVERY_QUEUE = 2, 32
_ASK_AGAIN_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedCloud:
    """A cloud as it came, on the left camera's pixel grid; the arrays are read-only.

    Args:
        header: numbers, times, session, ...
        xyz: (H, W, 3) float32, mm, NaN where unknown.
        gray: (H, W) uint8, the texture; None on ``cloud/depth``.
        sigma: (H, W) float32, mm, one standard deviation along the viewing ray; None on ``cloud/depth``.
    """

    header: wire.CloudHeader
    xyz: NDArray[np.float32]
    gray: NDArray[np.uint8] | None
    sigma: NDArray[np.float32] | None

    @property
    def every(self) -> int:
        """Spacing of the measured pixels: 2 = an overloaded rig gave every second row and column of its camera."""
        return _every(self.header)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where there is a point, (H, W)."""
        return np.isfinite(self.xyz[..., 2])

    @property
    def points(self) -> NDArray[np.float32]:
        """The valid points alone, (N, 3), mm."""
        return self.xyz[self.valid]


class _Stream:
    """What the blocking and the async subscription share; takes messages, never waits."""

    def __init__(
        self, endpoint: str, topic: str, *, latest: bool, timeout_s: float | None, keys: Keys | None = None
    ) -> None:
        if topic not in TOPICS:
            raise FringedError(f"topic {topic!r} carries no clouds; choose {' or '.join(TOPICS)}")
        self.topic, self.latest, self.timeout_s = topic, latest, timeout_s
        self._with_keys = keys is not None
        self.received = self.skipped = 0
        self._losses = Losses()
        self._rays: wire.Message | None = None
        self._asked_s = time.monotonic()
        self._clouds = Receiver(endpoint, [topic], queue=_LATEST_QUEUE if latest else _EVERY_QUEUE, keys=keys)
        self._meta: Receiver | None = None
        if topic == "cloud/depth":
            # A socket of its own: clouds must never push the rays out of a short queue.
            self._meta = Receiver(endpoint, ["meta/rays"], queue=4, keys=keys)

    @property
    def lost(self) -> int:
        """Clouds that were measured, or triggered, and never came here: gaps in ``seq`` within a session."""
        return self._losses.count

    def close(self) -> None:
        """Disconnect; may be called twice."""
        self._clouds.close()
        if self._meta is not None:
            self._meta.close()

    def _sockets(self) -> list[zmq.Socket[Any]]:
        return [self._clouds.socket] + ([self._meta.socket] if self._meta is not None else [])

    def _take(self) -> ReceivedCloud | None:
        """The newest (or the next) cloud that is already here."""
        self._take_rays()
        frames = self._clouds.take()
        while frames is not None:
            _, header = wire.decode_header(frames)
            self._losses.see(header.session, header.seq)
            newer = self._clouds.take() if self.latest else None
            if newer is None:
                break
            self.skipped += 1
            frames = newer
        return None if frames is None else self._cloud(wire.decode(frames))

    def _take_rays(self) -> None:
        while self._meta is not None and (frames := self._meta.take()) is not None:
            message = wire.decode(frames)
            if "rays" in message.arrays and message.arrays["rays"].shape[2:] == (2,):
                self._rays = message

    def _cloud(self, message: wire.Message) -> ReceivedCloud | None:
        header, arrays = message.header, message.arrays
        if not isinstance(header, wire.CloudHeader):
            raise WireError(f"{message.topic}: kind {header.kind!r}, expected 'cloud'")
        grid = (header.height, header.width)
        if self._meta is None:
            _check(message, {"xyz": ("<f4", (*grid, 3)), "gray": ("|u1", grid), "sigma": ("<f4", grid)})
            made = ReceivedCloud(header, arrays["xyz"], arrays["gray"], arrays["sigma"])
        else:
            _check(message, {"z": ("<u2", grid)})
            if not self._rays_fit(header):
                return None
            made = ReceivedCloud(header, _rebuilt(message, self._rays), None, None)
        self.received += 1
        return made

    def _rays_fit(self, header: wire.CloudHeader) -> bool:
        """Whether the rays at hand are those of this cloud; asks for them if not."""
        rays = self._rays
        if rays is not None and rays.header.calibration == header.calibration:
            return _rays_of(rays, header).shape[:2] == (header.height, header.width)
        now_s = time.monotonic()
        if self._meta is not None and now_s - self._asked_s > _ASK_AGAIN_S:
            self._asked_s = now_s
            self._meta.ask_again("meta/rays")
        return False

    def _silence(self) -> SilenceError:
        hint = ", does it know this key, and is that its server key?" if self._with_keys else "?"
        return SilenceError(
            f"no {self.topic} from {self._clouds.endpoint} within {self.timeout_s} s; is a daemon running{hint}"
        )

    def _deadline_s(self) -> float:
        return float("inf") if self.timeout_s is None else time.monotonic() + self.timeout_s


class Subscription(_Stream):
    """Clouds, one after the other; made by :func:`subscribe`."""

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> ReceivedCloud:
        """The newest cloud that was not yet given (or the next one), waiting for it.

        Raises:
            SilenceError: none came within the time-out; calling again goes on waiting.
            WireError: a message that does not follow the format; calling again goes on after it.
        """
        deadline_s = self._deadline_s()
        poller = zmq.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise self._silence()
            poller.poll(_wait_ms(left_s))
        return cloud

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncSubscription(_Stream):
    """Clouds for ``async for``; made by :func:`asubscribe`."""

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> ReceivedCloud:
        """Like ``Subscription.__next__``, without holding up the event loop."""
        import zmq.asyncio

        deadline_s = self._deadline_s()
        poller = zmq.asyncio.Poller()
        for socket in self._sockets():
            poller.register(socket, zmq.POLLIN)
        while (cloud := self._take()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise self._silence()
            await poller.poll(_wait_ms(left_s))
        return cloud

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


def subscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
) -> Subscription:
    """Clouds of a daemon, for ``for`` and ``with``; it connects, and connects again, by itself.

    Args:
        endpoint: ``tcp://HOST:PORT`` or ``ipc://PATH``.
        topic: ``cloud/full``, or ``cloud/depth`` for a slow line (points only; needs the package blosc2).
        latest: always give the newest cloud and skip older ones; False: every cloud, as far as the queues reach.
        timeout_s: longest silence before SilenceError; None waits for ever.
        keys: for a daemon on another machine: ``Keys.load("laptop.key", "server.pub")``.
    """
    return Subscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys)


def asubscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    *,
    topic: str = "cloud/full",
    latest: bool = True,
    timeout_s: float | None = None,
    keys: Keys | None = None,
) -> AsyncSubscription:
    """The same for ``async for`` and ``async with``."""
    return AsyncSubscription(endpoint, topic, latest=latest, timeout_s=timeout_s, keys=keys)


def _wait_ms(left_s: float) -> int:
    """At most a second, so that rays that went astray are asked for again."""
    return max(1, round(1000 * min(left_s, 1.0)))


def _check(message: wire.Message, expected: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, (dtype, shape) in expected.items():
        array = message.arrays.get(name)
        if array is None or array.dtype.str != dtype or array.shape != shape:
            came = "is missing" if array is None else f"is {array.dtype.str} {list(array.shape)}"
            raise WireError(f"{message.topic}: part {name!r} {came}, expected {dtype} {list(shape)}")


def _every(header: wire.Header) -> int:
    every = header.stats.get("every", 1) if isinstance(header, wire.CloudHeader) else 1
    return every if isinstance(every, int) and every > 0 else 1


def _rays_of(rays: wire.Message, header: wire.Header) -> NDArray[np.float32]:
    """The rays of a cloud's pixels, (height, width, 2) if they fit."""
    known, every = rays.arrays["rays"], _every(header)
    if isinstance(header, wire.CloudHeader) and known.shape[:2] != (header.height, header.width):
        return known[::every, ::every]
    return known


def _rebuilt(message: wire.Message, rays: wire.Message | None) -> NDArray[np.float32]:
    """Points of a depth message: xyz = z * (rx, ry, 1), NaN where the stored number is 0."""
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
