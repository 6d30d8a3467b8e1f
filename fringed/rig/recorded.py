"""Recordings behind the interface of a running daemon."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import msgspec
import numpy as np

from fringed.control.arguments import checked_timeout_or_none
from fringed.errors import ArgumentError, FringedError, NotLiveError
from fringed.parts import BASIC, PARTS, parse_parts
from fringed.protocol.status import CalibrationCheck, DriftSummary, HealthSummary, Mode, Recorder, Status
from fringed.rig.preview import Preview
from fringed.rig.source import TIMEOUT_S, Source
from fringed.stream.cloud_stream import TOPICS
from fringed.stream.received_cloud import ReceivedCloud

T = TypeVar("T")
FILE_NAMES = {"sigma": "sigma_mm"}
"""Names of parts in files, where they differ from those in messages."""


class Reader(Protocol):
    """What a kind of recording provides.

    Args:
        place: path or URL; device, session, calibration, mode: as in the status, empty where they are not recorded.
    """

    place: str
    device: str
    session: str
    calibration: str
    mode: str

    def clouds(self, parts: tuple[str, ...] | None) -> Iterator[ReceivedCloud]:
        """Yield the clouds from the first on, in their order.

        Args:
            parts: that each shall have; None: points only, on the camera's grid, as on ``cloud/depth``.
        """

    def previews(self) -> Iterator[Preview]:
        """Yield the images from the first on; NotLiveError if the recording has none."""

    def settings(self) -> list[dict[str, Any]]:
        """Return rows of the settings that can change, as ``get`` does."""

    def set(self, path: str, value: Any) -> Any:
        """Change one of these settings from the next cloud on; return its new value."""

    def close(self) -> None:
        """Close the files; may be called twice."""


class RecordedItems(Generic[T]):
    """Items of a recording for ``for`` and ``async for``, as from a running daemon; ends at the end."""

    def __init__(self, items: Callable[[], Iterator[T]], *, repeat: bool) -> None:
        self._open, self._repeat = items, repeat
        self._items: Iterator[T] | None = None
        self._begun = False
        self.received = self.skipped = 0
        self._closed = False

    @property
    def lost(self) -> int:
        """Always 0: a recording gives every item."""
        return 0

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        """Return the next item."""
        if self._closed:
            raise StopIteration
        while True:
            if self._items is None:
                self._items, self._begun = self._open(), False
            for item in self._items:
                self._begun = True
                self.received += 1
                return item
            self._items = None
            if not self._repeat or not self._begun:
                self._closed = True
                raise StopIteration

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        """Return the next item, computed in another thread."""
        item = await asyncio.to_thread(next, self, None)
        if item is None:
            raise StopAsyncIteration
        return item

    def close(self) -> None:
        """End the iteration; may be called twice."""
        self._closed, self._items = True, None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class Recording(Source):
    """A recording with the interface of a running daemon.

    It gives every cloud once, without waiting. ``get`` and ``set`` reach the settings of the reconstruction,
    ``snapshot`` writes into the working directory; what needs devices raises NotLiveError.

    Args:
        reader: of this kind of recording; repeat: begin again at the end.
    """

    def __init__(self, reader: Reader, *, repeat: bool = False) -> None:
        self._reader, self._repeat = reader, repeat
        self.address = reader.place
        self._last: ReceivedCloud | None = None
        self._clouds = 0
        self._start_s = time.monotonic()
        self._methods: dict[str, Callable[..., Any]] = {
            "hello": self._hello,
            "status": self._status,
            "get": self._get,
            "set": self._set,
            "snapshot": self._snapshot,
            "pattern.mode": self._mode,
        }

    def __repr__(self) -> str:
        return f"fringed.open({self.address!r})"

    def clouds(
        self,
        *,
        topic: str = "cloud/full",
        parts: Iterable[str] | None = None,
        latest: bool = True,
        timeout_s: float | None = TIMEOUT_S,
    ) -> RecordedItems[ReceivedCloud]:
        """Return every cloud of the recording; ``latest`` and ``timeout_s`` have no effect."""
        if topic not in TOPICS:
            raise ArgumentError(f"topic {topic!r} carries no clouds; choose {' or '.join(TOPICS)}, or name parts")
        checked_timeout_or_none(timeout_s)
        del latest
        wanted = parse_parts(parts) if parts is not None else BASIC if topic == TOPICS[0] else None

        def items() -> Iterator[ReceivedCloud]:
            for cloud in self._reader.clouds(wanted):
                self._last, self._clouds = cloud, self._clouds + 1
                yield cloud

        return RecordedItems(items, repeat=self._repeat)

    def previews(self, *, timeout_s: float | None = TIMEOUT_S) -> RecordedItems[Preview]:
        """Return the images of every cloud of a take."""
        checked_timeout_or_none(timeout_s)
        return RecordedItems(self._reader.previews, repeat=self._repeat)

    def call(self, method: str, /, **params: Any) -> Any:
        """Call a method as of a daemon.

        Raises:
            NotLiveError: it needs a running daemon.
        """
        function = self._methods.get(method)
        if function is None:
            raise NotLiveError(
                f"{self.address} is a recording: {method} needs a running daemon (fringed.Rig); a recording has "
                f"{', '.join(self._methods)}"
            )
        return function(**params)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    def _hello(self) -> dict[str, Any]:
        from fringed import __version__

        return {
            "program": "fringed",
            "version": __version__,
            "protocol": 1,
            "device": self._reader.device,
            "session": self._reader.session,
            "stream": [],
            "methods": sorted(self._methods),
        }

    def _status(self) -> dict[str, Any]:
        last = self._last
        points = 0 if last is None else int(last.valid.sum())
        unchecked = CalibrationCheck(policy="withhold", verdict="unknown", reason="", readings={}, withheld=0)
        status = Status(
            state="running", reasons=[], warnings=[], device=self._reader.device, session=self._reader.session,
            version=self._hello()["version"], pid=0, t_ns=0 if last is None else last.header.t_ns,
            uptime_s=round(time.monotonic() - self._start_s, 1), calibration=self._reader.calibration,
            pairs=self._clouds, clouds=self._clouds, pair_rate_hz=0.0, cloud_rate_hz=0.0, points=points,
            valid=0.0 if last is None else round(points / last.valid.size, 4), measured_every=1, latency_ms={},
            publish_latency_ms={}, stages_ms={}, garbage={}, processors={}, calibration_check=unchecked, drops={},
            drops_starting={}, cameras={}, sinks={}, recorder=Recorder(recording=False), kernels={},
            selfcheck=DriftSummary(enabled=False), health=HealthSummary(enabled=False), mode=self._reader.mode,
            sequence=Mode(mode=self._reader.mode),
        )  # fmt: skip
        plain: dict[str, Any] = msgspec.to_builtins(status)
        return plain

    def _get(self, path: str = "", *, detail: bool = False) -> Any:
        rows = self._reader.settings()
        chosen = [row for row in rows if not path or row["path"] == path or row["path"].startswith(f"{path}.")]
        if not chosen:
            raise FringedError(f"{self.address} has no setting {path!r:.100}; settings() lists them")
        if detail or not path:
            return {"settings": chosen}
        if chosen[0]["path"] == path:
            return chosen[0]["value"]
        return {row["path"].removeprefix(f"{path}."): row["value"] for row in chosen}

    def _set(self, path: str, value: Any) -> dict[str, Any]:
        if not any(row["path"] == path for row in self._reader.settings()):
            raise NotLiveError(
                f"{self.address} is a recording without the setting {path!r:.100}; settings() lists them"
            )
        return {path: self._reader.set(path, value)}

    def _mode(self, name: str | None = None) -> dict[str, Any]:
        if name is not None and name != self._reader.mode:
            raise NotLiveError(f"{self.address} was recorded in the mode {self._reader.mode}, which cannot change")
        return {"mode": self._reader.mode}

    def _snapshot(self, name: str = "snapshot") -> dict[str, Any]:
        cloud = self._last
        if cloud is None:
            raise FringedError(f"{self.address}: there is no cloud yet; read one with clouds() first")
        path = Path.cwd() / f"{name}_{cloud.header.seq:06d}.npz"
        np.savez(path, **_arrays(cloud))
        return {
            "file": str(path), "seq": cloud.header.seq, "t_ns": cloud.header.t_ns, "points": int(cloud.valid.sum()),
        }  # fmt: skip


def _arrays(cloud: ReceivedCloud) -> dict[str, Any]:
    """The arrays of a snapshot by their names there."""
    arrays = {FILE_NAMES.get(name, name): getattr(cloud, name) for name in PARTS}
    return {name: array for name, array in arrays.items() if array is not None}
