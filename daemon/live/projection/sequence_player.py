"""Shows the images of a sequence over and over, each until a pair is confirmed to show it.

    idle --play--> playing --hold--> idle --play--> ...
                      |  an image fails: the set is dropped, the next attempt begins with the first image

A set is complete or dropped; its pairs get numbers of their own, ``k * frames + i`` for frame i of set k, because
the cameras' triggers continue while an image settles.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.live.items import ImageSet, Pair
from daemon.live.projection.confirmed_capture import CaptureCancelledError, ConfirmedCapture
from drivers.protocols import TRIGGER_MODULUS

log = logging.getLogger("fringed.sequence")

RETRY_S = 1.0
HOLD_S = 20.0
_QUEUE = 4
_JOIN_S = 5.0

MakeCapture = Callable[[LatestWinsQueue[Pair], Callable[[], bool]], ConfirmedCapture]


class SequencePlayer:
    """Plays a sequence in a thread of its own, from :meth:`play` to :meth:`hold`.

    Args:
        make_capture: from the queue of pairs, and a function that is true when the capture is to end.
        confirmed: takes each pair of a set, numbered. complete: takes each set. dropped: called for each that failed.
    """

    def __init__(
        self,
        make_capture: MakeCapture,
        *,
        confirmed: Callable[[Pair], None],
        complete: Callable[[ImageSet], None],
        dropped: Callable[[], None],
    ) -> None:
        self._make, self._confirmed, self._complete, self._dropped = make_capture, confirmed, complete, dropped
        self._queue: LatestWinsQueue[Pair] = LatestWinsQueue(_QUEUE)
        self._changed = threading.Condition()
        self._images: list[NDArray[np.uint8]] = []
        self._mode = ""
        self._enabled = self._busy = self._closed = False
        self._sets = 0
        self._thread: threading.Thread | None = None
        self.problem = ""
        self.index = 0

    @property
    def playing(self) -> bool:
        """Whether images are being shown, or shown again after a failure."""
        return self._enabled

    def offer(self, pair: Pair) -> None:
        """Take a pair of the cameras; the newest few are kept until the capture reads them."""
        self._queue.put(pair)

    def play(self, mode: str, images: list[NDArray[np.uint8]]) -> None:
        """Show these images, (H, W, 3) uint8, from now on, beginning with the first.

        Args:
            mode: of the sets.
        """
        with self._changed:
            if len(images) != len(self._images):
                self._sets = -(-self._sets * len(self._images) // len(images))  # the numbers only grow
            self._mode, self._images, self._enabled = mode, images, True
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._run, name="sequence", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def hold(self, timeout_s: float | None) -> None:
        """Show nothing more; returns when the projector is free.

        Args:
            timeout_s: None = return at once.

        Raises:
            DaemonError: the projector's driver hangs.
        """
        with self._changed:
            self._enabled = False
            self._changed.notify_all()
            if timeout_s is None:
                return
            if not self._changed.wait_for(lambda: not self._busy, timeout_s):
                raise DaemonError(f"the projector's driver does not return from an image within {timeout_s:g} s")
            self.problem = ""

    def close(self) -> bool:
        """End the thread; False when the projector's driver hangs."""
        with self._changed:
            self._enabled, self._closed = False, True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            return not self._thread.is_alive()
        return True

    def _run(self) -> None:
        while self._wait_until_enabled():
            try:
                self._play()
            except CaptureCancelledError:
                pass
            except Exception as error:  # whatever the driver raises, the sequence is tried again
                self._fail(error)
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()

    def _wait_until_enabled(self) -> bool:
        with self._changed:
            if self.problem and self._enabled:
                self._changed.wait_for(lambda: not self._enabled, RETRY_S)
            self._changed.wait_for(lambda: self._enabled or self._closed)
            self._busy = not self._closed
            return self._busy

    def _play(self) -> None:
        """Play set after set; a new capture, because another image may have been shown since the last turn."""
        capture = self._make(self._queue, lambda: not self._enabled)
        while self._enabled:
            with self._changed:
                mode, images = self._mode, self._images
            self._complete(ImageSet(tuple(self._pairs(capture, images)), mode))
            self._sets += 1
            if self.problem:
                log.info("sequence: the images are confirmed again")
                self.problem = ""

    def _pairs(self, capture: ConfirmedCapture, images: list[NDArray[np.uint8]]) -> list[Pair]:
        frames = len(images)
        first, pairs = self._sets % (TRIGGER_MODULUS // frames) * frames, []
        try:
            for self.index, image in enumerate(images):
                capture.show(image)
                pairs.append(capture.pair().renumbered(first + self.index))
                self._confirmed(pairs[-1])
        except BaseException:
            if pairs:
                self._sets += 1  # its numbers are used
                self._dropped()
            raise
        return pairs

    def _fail(self, error: Exception) -> None:
        problem = str(error) or type(error).__name__
        if problem != self.problem:
            log.warning("sequence: image %d: %s", self.index, problem)
        self.problem = problem
