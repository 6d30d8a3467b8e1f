"""Capture of images one after the other, each with pairs of raw images that are confirmed to show it.

A pair counts for an image only if both of its exposures began after the image's light was out: after the flip, the
projector's latency and a margin. The times of the exposures decide, never a count of frames, so that lost, late and
queued frames can delay an image but never exchange two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError
from daemon.live.items import Pair
from daemon.live.projection.latency_measurement import MAX_LATENCY_NS
from drivers.errors import DriverError
from drivers.protocols import Clock, CountsShown, Projector, ProjectorInfo

Image = NDArray[np.uint8]

_LEAST_MARGIN_NS = 25_000_000
_MARGIN_FRAMES = 2.0
"""The flip and the latency are known to about one period of the projector each."""
_WAIT_S = 0.1


class CaptureCancelledError(DaemonError):
    """The capture was cancelled."""


class Pairs(Protocol):
    """A queue of pairs in the order of their exposures."""

    def get(self, timeout_s: float) -> Pair | None:
        """The next pair, or None when none came in time."""


def settling_ns(info: ProjectorInfo, *, tolerance_ns: int) -> int:
    """Upper bound of the time from an image's flip to its light on the scene.

    Args:
        info: of the projector; tolerance_ns: how well the exposures' starts are known.
    """
    latency_ns = MAX_LATENCY_NS if info.latency_s is None else round(1e9 * info.latency_s)
    period_ns = round(1e9 / info.refresh_hz) if info.refresh_hz > 0 else 0
    return latency_ns + tolerance_ns + max(_LEAST_MARGIN_NS, round(_MARGIN_FRAMES * period_ns))


def patience_s(*, rendered: bool) -> float:
    """How long to wait for a pair: rendered images take long, triggers do not."""
    return 60.0 if rendered else 5.0


class ConfirmedCapture:
    """Shows images and waits for the pairs that show them; used by one thread.

    Args:
        projector, info: open. pairs: those of its cameras.
        settle_ns: see :func:`settling_ns`. patience_s: longest wait for a pair.
        cancelled: polled while waiting; True ends the capture.
    """

    def __init__(
        self,
        projector: Projector,
        info: ProjectorInfo,
        pairs: Pairs,
        *,
        clock: Clock,
        settle_ns: int,
        patience_s: float = 5.0,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        if info.fixed_image:
            raise DriverError(
                "the projector shows an image of its own and cannot show another; calibrate from images that were "
                "taken with it (--left, --right), or drive it through projector.driver: x11"
            )
        self._projector, self._pairs, self._clock = projector, pairs, clock
        self._settle_ns, self._patience_ns, self._cancelled = settle_ns, round(1e9 * patience_s), cancelled
        self._shown: Image | None = None
        self._lit_ns = 0
        self._restarts = self._count_restarts()

    def show(self, image: Image) -> None:
        """Show an (H, W, 3) uint8 image from now on; one that is shown already is not shown again.

        Raises:
            DriverError: the projector fails, or was started again since the last image.
        """
        if self._shown is None or not np.array_equal(image, self._shown):
            self._shown = None
            flip = self._projector.show(image)
            returned_ns = self._clock.realtime_ns()
            self._lit_ns = max(returned_ns, flip.t_realtime_ns if flip is not None else 0) + self._settle_ns
            self._shown = image.copy()
        self._check()

    def pair(self) -> Pair:
        """The next pair whose exposures begin from now on and see the image that is shown.

        Raises:
            DriverError: none came in time, or the projector failed. CaptureCancelledError: it was cancelled.
        """
        if self._shown is None:
            raise DriverError("no image is shown; show() comes first")
        since_ns = max(self._lit_ns, self._clock.realtime_ns())
        settling = min(max(0, since_ns - self._clock.realtime_ns()), self._settle_ns)
        end_ns = self._clock.monotonic_ns() + self._patience_ns + settling
        early = 0
        while self._clock.monotonic_ns() < end_ns:
            if self._cancelled():
                raise CaptureCancelledError("the capture was cancelled")
            pair = self._pairs.get(_WAIT_S)
            if pair is None:
                continue
            if min(pair.left.t_exposure_ns, pair.right.t_exposure_ns) >= since_ns:
                self._check()
                return pair
            early += 1
        self.reset()  # a clock that was set back would otherwise delay every later image too
        raise DriverError(
            f"no pair of images came within {self._patience_ns / 1e9:g} s ({early} were exposed too early); are both "
            "cameras triggered, and do their clocks agree?"
        )

    def each(self, images: Iterable[Image]) -> Iterator[Pair]:
        """Show the images in turn; yield the pair of each."""
        for image in images:
            self.show(image)
            yield self.pair()

    def reset(self) -> None:
        """Show the next image even if it is the last one: another may have been shown in between."""
        self._shown = None
        self._restarts = self._count_restarts()

    def _check(self) -> None:
        """Raise after a restart: the window shows its last image again, but what the cameras saw before is unknown."""
        problem, restarts = self._projector.problem(), self._count_restarts()
        if problem or restarts != self._restarts:
            self.reset()
            cause = problem or "the projector's window was started again"
            raise DriverError(f"{cause}; what was captured meanwhile does not count, capture it again")

    def _count_restarts(self) -> int:
        return self._projector.counted["restarts"] if isinstance(self._projector, CountsShown) else 0
