"""What leaves the measuring: items, and what takes them. A sink never makes the measuring wait."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from drivers.protocols import Frame
from pipeline.reconstruct.cloud import Cloud

if TYPE_CHECKING:
    from daemon.config.rig_config import RigConfig
    from daemon.rig.open_rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class PairItem:
    """Two raw frames of one exposure; both carry the same trigger number."""

    left: Frame
    right: Frame


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedFrame:
    """A frame whose partner is missing; only the recorder wants it."""

    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class CloudItem:
    """A reconstructed pair, or set of pairs in a multi-frame mode.

    Args:
        seq: number of the trigger; t_ns: start of exposure, CLOCK_REALTIME; both of a set's first image.
        left, right: the raw frames, the last ones of a set.
        latency_ms: from the start of exposure to the finished cloud.
        dropped: pairs that were dropped so far because the pipeline was busy or not ready.
        stride: spacing of the measured pixels of the left camera, 2 under overload.
        mode: name; frames: images of a set; span_ms: between the starts of its first and its last exposure.
    """

    seq: int
    t_ns: int
    cloud: Cloud
    left: Frame
    right: Frame
    latency_ms: float
    dropped: int = 0
    stride: int = 1
    mode: str = "single"
    frames: int = 1
    span_ms: float = 0.0

    @property
    def moved(self) -> int:
        """Pixels of a set that are unknown because something moved there meanwhile."""
        return self.cloud.moved

    @property
    def t_arrived_ns(self) -> int:
        """When the host had both frames, CLOCK_REALTIME."""
        return max(self.left.t_host_ns, self.right.t_host_ns)


Item = PairItem | UnpairedFrame | CloudItem


@runtime_checkable
class Changeable(Protocol):
    """A sink that can take over other settings, or another calibration, while it runs."""

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        """Prepare for them; nothing changes yet, and DaemonError refuses.

        Returns:
            What makes it so: called between two pairs, in the pipeline's thread; quick, never fails. Clouds that were
            offered before it are of the old calibration, those after it of the new one.
        """


class Sink(Protocol):
    """Takes items into a bounded queue of its own; its own thread does the work."""

    def offer(self, item: Item) -> bool:
        """Take an item, or refuse it (False) because the queue is full; never blocks.

        Kinds of items that the sink has no use for are taken as done.
        """

    def close(self) -> None:
        """Finish what is queued, within seconds, and let go of everything."""

    def status(self) -> dict[str, Any]:
        """Plain values that tell how it goes; the key ``problem`` names what is wrong, if anything."""
