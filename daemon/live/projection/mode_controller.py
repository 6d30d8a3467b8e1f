"""The mode of a running daemon: which images are on the scene, and which set a pair of them belongs to.

In mode ``single`` pairs pass by. In a multi-frame mode the controller takes every pair and delivers complete sets: of a
driven projector from pairs that are confirmed to show an image, of one with stored images from all pairs.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import RigConfig
from daemon.live.acquisition.set_assembler import SetAssembler
from daemon.live.items import SINGLE, ImageSet, Pair
from daemon.live.projection.confirmed_capture import ConfirmedCapture, patience_s, settling_ns
from daemon.live.projection.mode_plan import ModePlan, ShownSequence, make_plan
from daemon.live.projection.sequence_player import HOLD_S, SequencePlayer
from daemon.rig.open_rig import Rig
from drivers.errors import DriverError
from drivers.protocols import Clock, ProjectorInfo, StoresImages

log = logging.getLogger("fringed.sequence")

_SOON_NS = 5_000_000_000  # a clock that was set back must not delay the pairs for longer


class ModeController:
    """Decides what the projector shows, and who may use it.

    Args:
        config, rig: of the daemon.
        emit: takes the raw pairs of a set; measure: takes complete sets. Both must be quick.
        drops: counts incomplete sets; counter_restarts: how often the cameras' counters restarted.
    """

    def __init__(
        self,
        config: RigConfig,
        rig: Rig,
        *,
        emit: Callable[[Pair], None],
        measure: Callable[[ImageSet], None],
        drops: Counters,
        counter_restarts: Callable[[], int],
        clock: Clock,
    ) -> None:
        self._config, self._rig, self._clock = config, rig, clock
        self._emit, self._measure, self._drops, self._counter_restarts = emit, measure, drops, counter_restarts
        self.plan: ModePlan | None = make_plan(config.mode, config.sequence, rig)
        self._player = SequencePlayer(
            self._capture, confirmed=emit, complete=self._complete, dropped=lambda: self._incomplete(1)
        )
        frames = 1 if self.plan is None else len(self.plan.sequence)
        self._assembler: SetAssembler[Pair] = SetAssembler(frames, config.sequence.first_trigger)
        self._held: set[str] = {"start"}
        self._lock = threading.Lock()
        self._changing = False
        self._lit_ns = 0  # no pair that was exposed earlier shows the single image
        self._projector: ProjectorInfo | None = None
        self.sets, self.incomplete = 0, 0

    @property
    def mode(self) -> str:
        """The mode that is measured now."""
        return SINGLE if self.plan is None else self.plan.mode

    @property
    def stored(self) -> bool:
        """Whether the projector holds the images of the set."""
        return self.plan is not None and self._config.sequence.display == "stored"

    @property
    def driven(self) -> bool:
        """Whether the daemon shows the images of the set one by one."""
        return self.plan is not None and not self.stored

    @property
    def shown(self) -> ShownSequence | None:
        """The sequence on the scene, None for the rig's own pattern."""
        if self.plan is None:
            return None
        first = self._config.sequence.first_trigger if self.stored else 0
        return ShownSequence(self.plan.sequence.as_mapping(), {"first_pattern_sequence": str(first)})

    def light(self, projector: ProjectorInfo) -> None:
        """Light the scene; the projector is open. The sets begin with ``release("start")``."""
        self._projector = projector
        self._rig.projector.show(self._first_image(self.plan))

    def accept(self, pair: Pair) -> bool:
        """Take a pair that belongs to a set, or to nothing; False: it is measured by itself."""
        if self._changing:
            self._drops.add("pairs_mode_changing")
            return True
        if self.plan is None:
            early = 0 < self._lit_ns - pair.t_ns < _SOON_NS
            if early:
                self._drops.add("pairs_mode_changing")
            return early
        if self.stored:
            self._assemble(pair)
        else:
            self._player.offer(pair)
        return True

    @property
    def hides_unpaired(self) -> bool:
        """Whether unpaired frames are useless because it is unknown which image they show."""
        return self.driven or self._changing

    def hold(self, by: str, *, wait: bool = True) -> None:
        """Leave the projector to the caller, until :meth:`release` under the same name.

        Raises:
            DaemonError: the projector's driver hangs.
        """
        with self._lock:
            self._held.add(by)
        try:
            self._player.hold(HOLD_S if wait else None)
        except DaemonError:
            self.release(by)
            raise

    def pause(self, paused: bool) -> None:
        """Stop changing images while no triggers are accepted; returns at once."""
        if paused:
            self.hold("pause", wait=False)
        else:
            self.release("pause")

    def release(self, by: str) -> None:
        """End a hold; after the last one the set continues with its first image."""
        with self._lock:
            self._held.discard(by)
            if self._held or self.plan is None:
                return
            if self.driven:
                self._player.play(self.mode, self.plan.images)
            elif isinstance(self._rig.projector, StoresImages):  # other projectors hold their images already
                self._rig.projector.store(self.plan.images, self._config.sequence.first_trigger)

    def show_plain(self, image: NDArray[np.uint8]) -> None:
        """Show one image until :meth:`show_measuring`; nothing is measured under it in a multi-frame mode."""
        self.hold("image")
        try:
            self._rig.projector.show(image)
        except BaseException:
            self.release("image")
            raise

    def show_measuring(self) -> None:
        """Show the mode's own images again."""
        if not self.driven:
            self._rig.projector.show(self._first_image(self.plan))
        self.release("image")

    @contextmanager
    def changing(self, mode: str) -> Iterator[None]:
        """Change the mode for the block, with its first image shown; an exception in the block restores the old mode.

        Raises:
            DaemonError, DriverError, PipelineError: why it cannot be; nothing has changed.
        """
        if mode == self.mode:
            yield
            return
        if self._config.sequence.display == "stored":
            raise DaemonError("sequence.display is stored: what the projector holds changes with rig.yaml alone")
        plan, before = make_plan(mode, self._config.sequence, self._rig), self.plan
        self.hold("change")
        self._changing = True
        try:
            self._show_first(plan)
            self.plan = plan
            yield
        except BaseException:
            self.plan = before
            with suppress(DriverError):
                self._show_first(before)
            raise
        finally:
            self._changing = False
            self.release("change")
        log.info("mode: %s", self.mode)

    def problem(self) -> str:
        """Why there may be no light or no sets; empty when all is well."""
        if self._player.playing:
            # Between two images a projector always reports a problem; each image is confirmed before its pair counts.
            return f"sequence: {self._player.problem}" if self._player.problem else ""
        dark = self._rig.projector.problem()
        if dark:
            return f"projector: {dark}"
        if self.stored and self._lost_count():
            return (
                "sequence: the cameras' trigger counters restarted, so it is unknown which stored image a trigger "
                "shows; set sequence.first_trigger and restart"
            )
        return ""

    def status(self) -> dict[str, Any]:
        """Mode, images of a set, sets so far, and who holds the projector."""
        if self.plan is None:
            return {"mode": SINGLE}
        return {
            "mode": self.mode,
            "frames": len(self.plan.sequence),
            "display": self._config.sequence.display,
            "sets": self.sets,
            "sets_incomplete": self.incomplete,
            "held": sorted(self._held),
        }

    def close(self) -> bool:
        """End; False when the projector's driver hangs."""
        return self._player.close()

    def _complete(self, image_set: ImageSet) -> None:
        self.sets += 1
        self._measure(image_set)

    def _incomplete(self, count: int) -> None:
        if count:
            self.incomplete += count
            self._drops.add("sets_incomplete", count)

    def _assemble(self, pair: Pair) -> None:
        """Take a pair of a projector that holds the images; called for one pair at a time."""
        self._emit(pair)
        before = self._assembler.incomplete
        pairs = self._assembler.feed(pair.seq, pair.t_ns, pair)
        self._incomplete(self._assembler.incomplete - before)
        if pairs is not None and not self._lost_count():
            self._complete(ImageSet(pairs, self.mode))

    def _lost_count(self) -> bool:
        """Whether it is unknown which stored image a trigger shows."""
        return self._assembler.restarts > 0 or self._counter_restarts() > 0

    def _first_image(self, plan: ModePlan | None) -> NDArray[np.uint8]:
        rig = self._rig
        return rig.pattern.image(rig.calibration.response) if plan is None else plan.images[0]

    def _show_first(self, plan: ModePlan | None) -> None:
        info = self._open_projector()
        self._rig.projector.show(self._first_image(plan))
        self._lit_ns = self._clock.realtime_ns() + self._settle_ns(info)

    def _open_projector(self) -> ProjectorInfo:
        if self._projector is None:
            raise DaemonError("the daemon is still starting; try again when it is running")
        return self._projector

    def _settle_ns(self, info: ProjectorInfo) -> int:
        settle_ms = self._config.sequence.settle_ms
        if settle_ms is not None:
            return round(1e6 * settle_ms)
        return settling_ns(info, tolerance_ns=round(1000 * self._config.pairing.tolerance_us))

    def _capture(self, queue: LatestWinsQueue[Pair], cancelled: Callable[[], bool]) -> ConfirmedCapture:
        info = self._open_projector()
        return ConfirmedCapture(
            self._rig.projector,
            info,
            queue,
            clock=self._clock,
            settle_ns=self._settle_ns(info),
            patience_s=patience_s(rendered=self._rig.board is not None),
            cancelled=cancelled,
        )
