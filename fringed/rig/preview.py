"""Previews: both camera images and the modulation as JPEG."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Self

from fringed import wire
from fringed.control.arguments import checked_timeout_or_none
from fringed.errors import SilenceError, WireError
from fringed.keys import Keys
from fringed.stream.receiver import Receiver

TOPIC = "preview"
PARTS = ("left", "right", "overlay")
_QUEUE = 2


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """The images of one trigger.

    Args:
        header: number, time, session; left, right: JPEG files, images of the cameras.
        overlay: JPEG file, modulation of the left image, saturated pixels red.
    """

    header: wire.Header
    left: bytes
    right: bytes
    overlay: bytes


def preview_of(message: wire.Message) -> Preview:
    """Return the preview in a message; WireError when a part is missing."""
    missing = [name for name in PARTS if name not in message.arrays]
    if missing:
        raise WireError(f"{message.topic}: part {missing[0]!r} is missing")
    return Preview(message.header, *(message.arrays[name].tobytes() for name in PARTS))


class PreviewStream:
    """Previews of a daemon, for ``for`` and ``async for``; the newest one is returned, older ones are skipped."""

    def __init__(self, endpoint: str, *, timeout_s: float | None, keys: Keys | None) -> None:
        self._timeout_s = checked_timeout_or_none(timeout_s)
        self._receiver = Receiver(endpoint, [TOPIC], queue=_QUEUE, keys=keys)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Preview:
        """Wait for the next preview; SilenceError when none comes in time."""
        deadline_s = self._deadline_s()
        while (preview := self._newest()) is None:
            self._receiver.poll(self._wait_s(deadline_s))
        return preview

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Preview:
        """Wait like ``__next__``, without blocking the event loop."""
        import zmq.asyncio

        deadline_s, poller = self._deadline_s(), zmq.asyncio.Poller()
        poller.register(self._receiver.socket, zmq.POLLIN)
        while (preview := self._newest()) is None:
            await poller.poll(max(1, round(1000 * self._wait_s(deadline_s))))
        return preview

    def close(self) -> None:
        """Disconnect; may be called twice."""
        self._receiver.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _newest(self) -> Preview | None:
        frames = None
        while (newer := self._receiver.take()) is not None:
            frames = newer
        return None if frames is None else preview_of(wire.decode(frames))

    def _deadline_s(self) -> float:
        return float("inf") if self._timeout_s is None else time.monotonic() + self._timeout_s

    def _wait_s(self, deadline_s: float) -> float:
        left_s = deadline_s - time.monotonic()
        if left_s <= 0:
            raise SilenceError(
                f"no preview from {self._receiver.endpoint} within {self._timeout_s} s; is the daemon measuring, and "
                "is stream.preview_hz more than 0?"
            )
        return min(left_s, 1.0)
