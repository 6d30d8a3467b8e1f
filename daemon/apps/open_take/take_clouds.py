"""A take as a stream of clouds for ``fringed.open``: the same messages as from a running daemon."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from daemon.apps.replay.runner import Replay, Result
from daemon.apps.reprocess.locations import location
from daemon.common.errors import DaemonError
from daemon.config import parse_rig
from daemon.control.settings.catalogue import catalogue
from daemon.control.settings.flatten import PIPELINE, leaves, settings_of, with_value
from daemon.live.items import SINGLE, CloudItem
from daemon.live.publishing import messages
from daemon.live.publishing.messages import Origin
from daemon.recording.read.take_reader import TakeReader
from drivers.protocols import Frame
from fringed import wire
from fringed.errors import RecordingError
from fringed.parts import BASIC, topic_of
from fringed.rig.preview import Preview, preview_of
from fringed.stream.received_cloud import ReceivedCloud, full_cloud
from pipeline.common.errors import PipelineError


class TakeClouds:
    """The reconstruction of a take, pair by pair, as by ``fringed replay``.

    Args:
        place: path or URL.

    Raises:
        RecordingError: no take there, or one that cannot be reconstructed.
    """

    def __init__(self, place: str) -> None:
        self.place = place
        self._config = parse_rig("cameras: {driver: sim}")  # only its settings of the pipeline are used
        try:
            self._take = TakeReader(location(place))
            self._replay = Replay(self._take)
            self.calibration = self._replay.calibration_file.identity
            sequence = self._replay.sequence
        except (DaemonError, PipelineError, OSError) as error:
            raise RecordingError(str(error) if place in str(error) else f"{place}: {error}") from error
        self.device = self._take.metadata.get("device", "")
        self.session = self._take.metadata.get("session", "")
        self.mode = SINGLE if sequence is None else sequence.name
        self._frames = 1 if sequence is None else len(sequence)
        self._origin = Origin(self.device, self.session, self.calibration)

    def clouds(self, parts: tuple[str, ...] | None) -> Iterator[ReceivedCloud]:
        """Yield the cloud of every pair, or of every complete set, with these parts, or with points only.

        Raises:
            RecordingError: the files of the take do not match, or no pair gives a cloud.
        """
        names = BASIC if parts is None else parts
        self._replay.parts = names
        for item in self._items():
            yield self._points(item) if parts is None else self._cloud(item, names)

    def previews(self) -> Iterator[Preview]:
        """Yield the images of every cloud."""
        from daemon.live.publishing.preview import preview

        for item in self._items():
            yield preview_of(wire.decode(preview(self._origin, item)))

    def settings(self) -> list[dict[str, Any]]:
        """Return the settings of the reconstruction."""
        return catalogue(self._config, self._replay.settings, PIPELINE)

    def set(self, path: str, value: Any) -> Any:
        """Change one from the next cloud on.

        Raises:
            RecordingError: an invalid value; nothing is changed.
        """
        try:
            self._config = with_value(self._config, self._replay.settings, path, value, Path())
        except (DaemonError, ValueError, TypeError) as error:
            raise RecordingError(f"{self.place}: {path} cannot be {value!r:.60}: {error}") from error
        self._replay.change(settings_of(self._config))
        return leaves(self._config, self._replay.settings)[path]

    def close(self) -> None:
        """Close the files."""
        self._take.close()

    def _cloud(self, item: CloudItem, parts: tuple[str, ...]) -> ReceivedCloud:
        if parts == BASIC:
            return full_cloud(wire.decode(messages.full(self._origin, item)))
        frames = messages.parts(self._origin, item, topic_of(parts), parts)
        if frames is None:
            raise RecordingError(f"{self.place}: pair {item.seq} does not give the parts {', '.join(parts)}")
        return full_cloud(wire.decode(frames), parts)

    def _points(self, item: CloudItem) -> ReceivedCloud:
        """The points on the camera's grid, as on ``cloud/depth``."""
        on_grid = replace(item, cloud=item.cloud.grid or item.cloud)
        return replace(self._cloud(on_grid, BASIC), gray=None, sigma=None, interpolated=None)

    def _items(self) -> Iterator[CloudItem]:
        count = 0
        try:
            for result in self._replay.results():
                count += 1
                yield self._item(result)
        except (DaemonError, PipelineError, OSError) as error:
            raise RecordingError(f"{self.place}: {error}") from error
        if count == 0:
            reasons = [failure.error for failure in self._replay.failures[:1]] or self._take.problems
            raise RecordingError(f"{self.place}: no pair gives a cloud: {(reasons or ['the take is empty'])[0]}")

    def _item(self, result: Result) -> CloudItem:
        pair = result.pair
        numbers = pair.sequence, pair.t_ns, pair.t_ns, pair.encoding
        left, right = Frame("left", *numbers, pair.left), Frame("right", *numbers, pair.right)
        latency_ms = round(result.runs[-1].total_ms, 2)
        return CloudItem(
            pair.sequence, pair.t_ns, result.cloud, left, right, latency_ms, mode=self.mode, frames=self._frames
        )
