"""The interface that a running daemon and a recording have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from typing import Any, Protocol, Self, TypeVar

import msgspec

from fringed.errors import ControlError
from fringed.protocol.answers import Changed, Hello, Setting, Settings, Shown, Snapshot, State, Takes
from fringed.protocol.health import Event, Health, History
from fringed.protocol.status import Mode, Status
from fringed.rig.preview import Preview
from fringed.rig.running_take import RunningTake
from fringed.stream.received_cloud import ReceivedCloud

T = TypeVar("T")
TIMEOUT_S = 10.0
"""Default of every time-out: of an answer, and of the wait for a cloud."""


class Clouds(Protocol):
    """Clouds for ``for`` or ``async for``, and for ``with`` or ``async with``.

    ``received``: clouds returned; ``lost``: triggered and not received; ``skipped``: received and older than the
    newest one.
    """

    received: int
    skipped: int

    @property
    def lost(self) -> int: ...  # noqa: D102 - described above
    def __iter__(self) -> Iterator[ReceivedCloud]: ...
    def __next__(self) -> ReceivedCloud: ...
    def __aiter__(self) -> AsyncIterator[ReceivedCloud]: ...
    async def __anext__(self) -> ReceivedCloud: ...
    def __enter__(self) -> Self: ...
    def __exit__(self, *_: object) -> None: ...
    async def __aenter__(self) -> Self: ...
    async def __aexit__(self, *_: object) -> None: ...
    def close(self) -> None: ...  # noqa: D102


class Previews(Protocol):
    """Previews for ``for`` or ``async for``."""

    def __iter__(self) -> Iterator[Preview]: ...
    def __next__(self) -> Preview: ...
    def __aiter__(self) -> AsyncIterator[Preview]: ...
    async def __anext__(self) -> Preview: ...
    def close(self) -> None: ...  # noqa: D102


class Source(ABC):
    """A running daemon or a recording; made by :class:`fringed.Rig` and :func:`fringed.open`.

    Every method that asks the daemon raises RefusedError with its message, NoDaemonError when it does not answer,
    and NotLiveError where a recording cannot do it. From ``async`` code: ``await asyncio.to_thread(rig.status)``.
    """

    address: str
    """Of the daemon's control, or the place of the recording."""

    @abstractmethod
    def clouds(
        self,
        *,
        topic: str = "cloud/full",
        parts: Iterable[str] | None = None,
        latest: bool = True,
        timeout_s: float | None = TIMEOUT_S,
    ) -> Clouds:
        """Return the clouds, for ``for``, ``async for`` and ``with``.

        Args:
            topic: ``cloud/full``, or ``cloud/depth`` for slow networks: points only.
            parts: instead of a topic: ``xyz`` and any of ``gray``, ``sigma``, ``rgb``, ``normals``, ``interpolated``.
            latest: skip clouds that are older than the newest one; False: every cloud, within the limits of the
                queues. A recording gives every cloud.
            timeout_s: longest wait for a cloud before SilenceError; another call continues to wait. None = no limit.
        """

    @abstractmethod
    def previews(self, *, timeout_s: float | None = TIMEOUT_S) -> Previews:
        """Return the camera images as JPEG, at most ten a second, for ``for`` and ``async for``."""

    @abstractmethod
    def call(self, method: str, /, **params: Any) -> Any:
        """Call a method of the protocol and return its result as plain values."""

    @abstractmethod
    def close(self) -> None:
        """Release connections or files; may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def hello(self) -> Hello:
        """Return device, session and version."""
        return self._answer("hello", Hello)

    def status(self) -> Status:
        """Return state, rates, counters and latencies."""
        return self._answer("status", Status)

    def health(self) -> Health:
        """Return the verdict with every quantity and limit."""
        return self._answer("health", Health)

    def health_events(self, most: int = 100) -> list[Event]:
        """Return the newest events, at most 1000, in the order of their beginning."""
        return self._answer("health.events", list[Event], most=most)

    def health_history(self, quantities: Sequence[str], *, seconds: float = 3600, points: int = 300) -> History:
        """Return at most 8 quantities over time, in at most 600 points."""
        return self._answer("health.history", History, quantities=list(quantities), seconds=seconds, points=points)

    def get(self, path: str) -> Any:
        """Return the value of a setting, such as ``pairing.tolerance_us``, or of a section as a mapping."""
        return self.call("get", path=path)

    def settings(self, below: str = "") -> list[Setting]:
        """Return the settings at or below a path with value, bounds, unit and meaning."""
        return self._answer("get", Settings, path=below, detail=True).settings

    def set(self, path: str, value: Any) -> Any:
        """Change a live setting between two clouds; return its new value."""
        return self.call("set", path=path, value=value)[path]

    def reload(self) -> Changed:
        """Apply rig.yaml and its files again, as a whole or not at all."""
        return self._answer("reload", Changed)

    def start(self) -> str:
        """Resume measuring; return the state."""
        return self._answer("start", State).state

    def stop(self) -> str:
        """Pause measuring, everything stays connected; return the state."""
        return self._answer("stop", State).state

    def snapshot(self, name: str = "snapshot") -> Snapshot:
        """Write the newest cloud as .npz into the directory of takes; of a recording, into the working directory."""
        return self._answer("snapshot", Snapshot, name=name)

    def record(self, name: str = "take", *, before_s: float = 0.0) -> RunningTake:
        """Begin a take; it ends with its ``stop()`` or with the ``with`` block.

        Args:
            name: beginning of the file's name; before_s: begin so long ago, as far as ``recording.before_s`` keeps it.
        """
        return RunningTake(self.call, name, before_s)

    def takes(self) -> Takes:
        """Return the takes of the daemon's directory, oldest first."""
        return self._answer("takes.list", Takes)

    def mode(self, name: str | None = None) -> Mode:
        """Return the mode; with a name (single, two_color, heterodyne, gray), set it first."""
        return self._answer("pattern.mode", Mode, **({} if name is None else {"name": name}))

    def show(self, name: str = "fringe") -> str:
        """Show the measuring fringe, or a plain image: white, black, red, green, blue."""
        return self._answer("pattern.show", Shown, name=name).shown

    def _answer(self, method: str, kind: type[T], /, **params: Any) -> T:
        answer = self.call(method, **params)
        try:
            return msgspec.convert(answer, kind)
        except msgspec.ValidationError as error:
            raise ControlError(
                f"{self.address} answers {method} in a form that this version does not know: {error}; use the same "
                "version of fringed on both sides"
            ) from error
