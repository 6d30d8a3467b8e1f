"""A camera as a GenICam program sees it: opened through harvesters, its frames copied out."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.sim.gentl.needs import missing

try:
    from genicam.genapi import AccessException
    from genicam.gentl import IoException, ResourceInUseException
    from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet
except ImportError as error:
    missing(f"harvesters and genicam cannot be imported: {error}")

__all__ = ["AccessException", "Capture", "Harvester", "Host", "IoException", "ResourceInUseException", "opened"]

WAIT_S = 20.0
CHUNKS = "Timestamp", "FrameID", "ExposureTime", "TriggersMissed"


@dataclass(frozen=True, slots=True)
class Capture:
    """A frame with what came beside it."""

    frame_id: int
    timestamp: int
    bytes: bytes
    size: tuple[int, int]
    offset: tuple[int, int]
    chunks: dict[str, float]


class _Count(Callback):
    def __init__(self) -> None:
        super().__init__()
        self.value = 0

    def emit(self, context: object | None = None) -> None:  # noqa: ARG002
        self.value += 1


class Host:
    """One camera, opened by its serial number."""

    def __init__(self, harvester: Harvester, serial: str) -> None:
        config = ParameterSet({ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: 10})
        self._acquirer = harvester.create({"serial_number": serial}, config=config)
        self._incomplete = _Count()
        self._acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        self.nodes: Any = self._acquirer.remote_device.node_map
        self.stream: Any = self._acquirer.data_streams[0].node_map

    @property
    def incomplete(self) -> int:
        """Buffers that came incomplete."""
        return self._incomplete.value

    def set(self, **features: object) -> None:
        """Set features in the order given."""
        for name, value in features.items():
            getattr(self.nodes, name).value = value

    def get(self, name: str) -> Any:
        """A feature's value."""
        return getattr(self.nodes, name).value

    def trigger_on(
        self, source: str = "Line1", *, selector: str = "FrameStart", activation: str = "RisingEdge"
    ) -> None:
        """Let one trigger wait for a line or for software."""
        self.set(TriggerSelector=selector, TriggerMode="On", TriggerSource=source, TriggerActivation=activation)

    def chunks_on(self) -> None:
        """All chunks with every frame."""
        self.set(ChunkModeActive=True)
        for name in CHUNKS:
            self.set(ChunkSelector=name, ChunkEnable=True)

    def start(self, buffers: int = 16) -> None:
        """Start the acquisition."""
        self._acquirer.num_buffers = buffers
        self._acquirer.start()

    def stop(self) -> None:
        """Stop the acquisition."""
        self._acquirer.stop()

    def capture(self, timeout_s: float = WAIT_S) -> Capture | None:
        """The next frame, None if none came."""
        deadline = time.monotonic() + timeout_s
        while True:
            buffer = self._acquirer.try_fetch(timeout=0.01)
            if buffer is not None:
                break
            if time.monotonic() > deadline:
                return None
        with buffer:
            module = buffer.module
            has_chunks = module.is_containing_chunk_data()
            return Capture(
                module.frame_id,
                module.timestamp,
                memoryview(module.raw_buffer)[: module.size_filled].tobytes(),  # "bytes" that change when queued again
                (module.width, module.height),
                (module.offset_x, module.offset_y),
                {name: getattr(self.nodes, f"Chunk{name}").value for name in CHUNKS} if has_chunks else {},
            )

    def captures(self, count: int) -> list[Capture]:
        """So many frames."""
        got = [self.capture() for _ in range(count)]
        assert None not in got, f"{got.index(None)} of {count} frames came"
        return [capture for capture in got if capture is not None]

    def nothing_comes(self) -> bool:
        """No frame waits; to be asked once the cable is idle."""
        return self.capture(0) is None

    def close(self) -> None:
        """Let go; of a camera that is gone only the second try succeeds."""
        for _ in range(2):
            with contextlib.suppress(IoException):
                self._acquirer.destroy()
                return


@contextlib.contextmanager
def opened(producer: Path, *serials: str) -> Iterator[list[Host]]:
    """Cameras by their serial numbers, in this process."""
    harvester = Harvester()
    harvester.add_file(str(producer))
    harvester.update()
    hosts: list[Host] = []
    try:
        for serial in serials:
            hosts.append(Host(harvester, serial))
        yield hosts
    finally:
        for host in hosts:
            host.close()
        harvester.reset()
