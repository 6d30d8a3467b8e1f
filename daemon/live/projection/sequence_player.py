"""The daemon shows the images of a set in turn, each with a pair that has surely seen it.

    idle --play--> playing --hold--> idle --play--> ...
                      |  an image fails: the set is dropped, the next try begins with the first image

A set is complete or it is nothing; its pairs get numbers of their own, ``k * frames + i`` for image i of set k,
because the cameras' triggers go on while an image settles.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.live.acquisition.pairer import Pair
from daemon.live.projection.confirmed_capture import CaptureCancelledError, ConfirmedCapture
from daemon.live.sets import ImageSet
from drivers.protocols import TRIGGER_MODULUS

log = logging.getLogger("fringed.sequence")

RETRY_S = 1.0
HOLD_S = 20.0
_ROOM = 4
_JOIN_S = 5.0

MakeCapture = Callable[[LatestWinsQueue[Pair], Callable[[], bool]], ConfirmedCapture]


class SequencePlayer:
    """Plays a sequence over and over, in a thread of its own, from :meth:`play` to :meth:`hold`.

    Args:
        shooting: makes what shows an image and waits for its pair, from the pairs and whether to give up.
        seen: takes each pair that is part of a set, numbered. whole: takes each set. dropped: told of each that failed.
    """

    def __init__(
        self,
        shooting: MakeCapture,
        *,
        seen: Callable[[Pair], None],
        whole: Callable[[ImageSet], None],
        dropped: Callable[[], None],
    ) -> None:
        self._make, self._seen, self._whole, self._dropped = shooting, seen, whole, dropped
        self._box: LatestWinsQueue[Pair] = LatestWinsQueue(_ROOM)
        self._changed = threading.Condition()
        self._images: list[NDArray[np.uint8]] = []
        self._mode = ""
        self._wanted = self._busy = self._closed = False
        self._sets = 0
        self._thread: threading.Thread | None = None
        self.problem = ""
        self.index = 0

    @property
    def playing(self) -> bool:
        """Whether images are being shown, or tried again after a failure."""
        return self._wanted

    def offer(self, pair: Pair) -> None:
        """Take a pair of the cameras; the newest few are kept until one is wanted."""
        self._box.put(pair)

    def play(self, mode: str, images: list[NDArray[np.uint8]]) -> None:
        """Show these images, (H, W, 3) uint8, from now on, beginning with the first.

        Args:
            mode: name that the sets get.
        """
        with self._changed:
            if len(images) != len(self._images):
                self._sets = -(-self._sets * len(self._images) // len(images))  # the numbers only grow
            self._mode, self._images, self._wanted = mode, images, True
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._run, name="sequence", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def hold(self, timeout_s: float | None) -> None:
        """Show nothing more; returns when the projector belongs to the caller.

        Args:
            timeout_s: None = come back at once.

        Raises:
            DaemonError: the projector's driver does not come back.
        """
        with self._changed:
            self._wanted = False
            self._changed.notify_all()
            if timeout_s is None:
                return
            if not self._changed.wait_for(lambda: not self._busy, timeout_s):
                raise DaemonError(f"the projector does not come back from its image within {timeout_s:g} s")
            self.problem = ""

    def close(self) -> bool:
        """End the thread; False when the projector's driver hangs."""
        with self._changed:
            self._wanted, self._closed = False, True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            return not self._thread.is_alive()
        return True

    def _give_up(self) -> bool:
        return not self._wanted

    def _run(self) -> None:
        while self._await_turn():
            try:
                self._play()
            except CaptureCancelledError:
                pass
            except Exception as error:  # whatever the driver does, the light comes back as soon as it can
                self._fail(error)
            finally:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()

    def _await_turn(self) -> bool:
        with self._changed:
            if self.problem and self._wanted:
                self._changed.wait_for(lambda: not self._wanted, RETRY_S)
            self._changed.wait_for(lambda: self._wanted or self._closed)
            self._busy = not self._closed
            return self._busy

    def _play(self) -> None:
        """Set after set; somebody else may have shown an image since the last turn."""
        shooting = self._make(self._box, self._give_up)
        while self._wanted:
            with self._changed:
                mode, images = self._mode, self._images
            self._whole(ImageSet(tuple(self._pairs(shooting, images)), mode))
            self._sets += 1
            if self.problem:
                log.info("sequence: the images are seen again")
                self.problem = ""

    def _pairs(self, shooting: ConfirmedCapture, images: list[NDArray[np.uint8]]) -> list[Pair]:
        frames = len(images)
        first, pairs = self._sets % (TRIGGER_MODULUS // frames) * frames, []
        try:
            for self.index, image in enumerate(images):
                shooting.show(image)
                pairs.append(_numbered(shooting.pair(), first + self.index))
                self._seen(pairs[-1])
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


def _numbered(pair: Pair, number: int) -> Pair:
    frames: list[Any] = [replace(frame, trigger=number) for frame in (pair.left, pair.right)]
    return Pair(*frames)
