"""The items that leave the live path, and the sinks that take them. A sink never makes the live path wait."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

from drivers.protocols import Frame

if TYPE_CHECKING:
    from daemon.common.heartbeat import Heartbeat
    from daemon.config.rig_config import RigConfig
    from daemon.rig.open_rig import Rig
    from pipeline.reconstruct.cloud import Cloud

SINGLE = "single"
"""The mode in which one pair makes a cloud."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two raw frames of one exposure; both carry the same trigger number."""

    left: Frame
    right: Frame

    mode: ClassVar[str] = SINGLE
    frames: ClassVar[int] = 1
    span_ms: ClassVar[float] = 0.0
    noun: ClassVar[str] = "pair"

    @property
    def seq(self) -> int:
        """Trigger number."""
        return self.left.trigger

    @property
    def t_ns(self) -> int:
        """Start of exposure, CLOCK_REALTIME."""
        return self.left.t_exposure_ns

    @property
    def images(self) -> tuple[Any, Any]:
        """The left and the right image."""
        return self.left.image, self.right.image

    def renumbered(self, number: int) -> Pair:
        """The same pair under another trigger number."""
        return Pair(replace(self.left, trigger=number), replace(self.right, trigger=number))


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """The pairs that make one cloud in a multi-frame mode.

    Args:
        pairs: one for each frame of the sequence, in its order; mode: whose sequence was shown.
    """

    pairs: tuple[Pair, ...]
    mode: str

    noun: ClassVar[str] = "set"

    @property
    def frames(self) -> int:
        """Number of pairs."""
        return len(self.pairs)

    @property
    def seq(self) -> int:
        """Trigger number of the first pair."""
        return self.pairs[0].seq

    @property
    def left(self) -> Frame:
        """The newest left frame."""
        return self.pairs[-1].left

    @property
    def right(self) -> Frame:
        """The newest right frame."""
        return self.pairs[-1].right

    @property
    def t_ns(self) -> int:
        """Start of the first exposure, CLOCK_REALTIME."""
        return self.pairs[0].t_ns

    @property
    def span_ms(self) -> float:
        """From the start of the first exposure to the start of the last one."""
        return (self.pairs[-1].t_ns - self.t_ns) / 1e6

    @property
    def images(self) -> tuple[list[Any], list[Any]]:
        """The left images and the right images."""
        return [pair.left.image for pair in self.pairs], [pair.right.image for pair in self.pairs]


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedFrame:
    """A frame whose partner is missing; only the recorder uses it."""

    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class CloudItem:
    """The cloud of a pair, or of an image set in a multi-frame mode.

    Args:
        seq: trigger number; t_ns: start of exposure, CLOCK_REALTIME; of a set, those of its first pair.
        left, right: the raw frames, the last ones of a set.
        latency_ms: from the start of exposure to the finished cloud.
        dropped: pairs that were dropped so far because the pipeline was busy or not ready.
        stride: spacing of the measured pixels of the left camera, 2 under overload.
        mode: name; frames: pairs of a set; span_ms: between the starts of its first and its last exposure.
    """

    seq: int
    t_ns: int
    cloud: Cloud
    left: Frame
    right: Frame
    latency_ms: float
    dropped: int = 0
    stride: int = 1
    mode: str = SINGLE
    frames: int = 1
    span_ms: float = 0.0

    @property
    def measured(self) -> Cloud:
        """The cloud before the cloud filters, on the left camera's pixel grid: what the monitors examine."""
        return self.cloud.measured or self.cloud

    @property
    def moved(self) -> int:
        """Pixels of a set that were rejected because the scene moved between its frames."""
        return self.cloud.moved

    @property
    def t_arrived_ns(self) -> int:
        """When the host had both frames, CLOCK_REALTIME."""
        return max(self.left.t_host_ns, self.right.t_host_ns)


Item = Pair | UnpairedFrame | CloudItem


@runtime_checkable
class Changeable(Protocol):
    """A sink that accepts other settings, or another calibration, while it runs."""

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare the change; nothing changes yet, and DaemonError rejects it.

        Returns:
            The commit: called between two pairs, in the pipeline's thread; quick, never fails. Clouds that were
            offered before it are of the old calibration, those after it of the new one.
        """


@runtime_checkable
class PartsReader(Protocol):
    """A sink that may need parts of a cloud that are computed only on demand."""

    def wanted_parts(self) -> frozenset[str]:
        """Names of these parts that the next cloud needs; called in the pipeline's thread, quick."""


class Sink(Protocol):
    """Takes items into a bounded queue of its own; its own thread does the work."""

    @property
    def heartbeat(self) -> Heartbeat | None:
        """Of the sink's thread, checked by the watchdog; None: the sink promises nothing."""

    def offer(self, item: Item) -> bool:
        """Take an item, or reject it (False) because the queue is full; never blocks.

        Kinds of items that the sink does not use count as taken.
        """

    def close(self) -> None:
        """Finish what is queued, within seconds, and release everything."""

    def status(self) -> dict[str, Any]:
        """The sink's state as plain values; the key ``problem`` names what is wrong, if anything."""
