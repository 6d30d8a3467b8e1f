"""The mode of a running daemon: which images are on the scene, and what a pair of them is part of.

In mode ``single`` it only looks on. In a multi-frame mode it takes every pair: of a driven projector the pairs that
have surely seen an image, of one with stored images all of them, and hands over whole sets.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import RigConfig
from daemon.live.acquisition.pairer import Pair
from daemon.live.acquisition.set_assembler import SetAssembler
from daemon.live.items import PairItem
from daemon.live.projection.confirmed_capture import ConfirmedCapture, patience_s, settling_ns
from daemon.live.projection.mode_plan import ModePlan, make_plan
from daemon.live.projection.sequence_player import HOLD_S, SequencePlayer
from daemon.live.sets import SINGLE, ImageSet, Shown
from daemon.rig.open_rig import Rig
from drivers.errors import DriverError
from drivers.protocols import Clock, ProjectorInfo

log = logging.getLogger("fringed.sequence")

_SOON_NS = 5_000_000_000  # a clock that was set back must not hold up the pairs for longer


@dataclass(frozen=True, slots=True)
class Outlets:
    """Where things go: raw pairs of a set, whole sets, counts; and how often the triggers' count began anew."""

    emit: Callable[[PairItem], None]
    offer: Callable[[ImageSet], None]
    drops: Counters
    counter_restarts: Callable[[], int]


class ModeController:
    """What the projector shows, and who may say so.

    Args:
        config, rig: of the daemon; outlets: must be quick.
    """

    def __init__(self, config: RigConfig, rig: Rig, outlets: Outlets, *, clock: Clock) -> None:
        self._config, self._rig, self._outlets, self._clock = config, rig, outlets, clock
        self.plan: ModePlan | None = make_plan(config.mode, config.sequence, rig)
        self._driver = SequencePlayer(
            self._shooting,
            seen=lambda pair: outlets.emit(PairItem(pair.left, pair.right)),
            whole=self._whole,
            dropped=lambda: self._incomplete(1),
        )
        self._gatherer = self._new_gatherer()
        self._held: set[str] = {"start"}
        self._lock = threading.Lock()
        self._changing = False
        self._lit_ns = 0  # no pair that was exposed earlier shows the single image
        self._refresh_hz = 0.0
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
    def shown(self) -> Shown | None:
        """What stands on the scene, None for the rig's own pattern."""
        if self.plan is None:
            return None
        first = self._config.sequence.first_trigger if self.stored else 0
        return Shown(self.plan.sequence.as_mapping(), {"first_pattern_sequence": str(first)})

    def light(self, projector: ProjectorInfo) -> None:
        """Light the scene; the projector is open. The sets begin with ``release("start")``."""
        self._refresh_hz = projector.refresh_hz
        self._rig.projector.show(self._first_image(self.plan))

    def takes(self, pair: Pair) -> bool:
        """Whether a pair is part of a set, or of nothing; else it is measured by itself."""
        if self._changing:
            self._outlets.drops.add("pairs_mode_changing")
            return True
        if self.plan is None:
            early = 0 < self._lit_ns - pair.left.t_exposure_ns < _SOON_NS
            if early:
                self._outlets.drops.add("pairs_mode_changing")
            return early
        if self.stored:
            self._gather(pair)
        else:
            self._driver.offer(pair)
        return True

    def takes_alone(self) -> bool:
        """Whether a frame without a partner says nothing, because nobody knows what it shows."""
        return self.driven or self._changing

    def hold(self, by: str, *, wait: bool = True) -> None:
        """Leave the projector to somebody, until :meth:`release` under the same name.

        Raises:
            DaemonError: the projector's driver does not come back.
        """
        with self._lock:
            self._held.add(by)
        try:
            self._driver.hold(HOLD_S if wait else None)
        except DaemonError:
            self.release(by)
            raise

    def pause(self, paused: bool) -> None:
        """No triggers are accepted, so that no image needs to change; comes back at once."""
        if paused:
            self.hold("pause", wait=False)
        else:
            self.release("pause")

    def release(self, by: str) -> None:
        """The projector is needed no longer for this; the set goes on with its first image if nobody else has it."""
        with self._lock:
            self._held.discard(by)
            if self._held or self.plan is None:
                return
            if self.driven:
                self._driver.play(self.mode, self.plan.images)
            else:
                self._store(self.plan)

    def show_plain(self, image: NDArray[np.uint8]) -> None:
        """Show one image until :meth:`show_measuring`; nothing is measured under it in a multi-frame mode."""
        self.hold("image")
        try:
            self._rig.projector.show(image)
        except BaseException:
            self.release("image")
            raise

    def show_measuring(self) -> None:
        """Show what is measured with again."""
        if not self.driven:
            self._rig.projector.show(self._first_image(self.plan))
        self.release("image")

    @contextmanager
    def changing(self, mode: str) -> Iterator[None]:
        """In the block the mode is another one and nothing is shown but its first image; an error takes it back.

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
        """Why there may be no light or no sets, or nothing."""
        if self._driver.playing:
            # Between two images a projector is never sure of its own; each one is confirmed before its pair counts.
            return f"sequence: {self._driver.problem}" if self._driver.problem else ""
        dark = self._rig.projector.problem()
        if dark:
            return f"projector: {dark}"
        if self.stored and self._lost_count():
            return (
                "sequence: the triggers' count began anew, so nobody knows which stored image a trigger shows; set "
                "sequence.first_trigger and restart"
            )
        return ""

    def status(self) -> dict[str, Any]:
        """Mode, images of a set, sets so far, and who has the projector meanwhile."""
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
        return self._driver.close()

    def _whole(self, one: ImageSet) -> None:
        self.sets += 1
        self._outlets.offer(one)

    def _incomplete(self, count: int) -> None:
        if count:
            self.incomplete += count
            self._outlets.drops.add("sets_incomplete", count)

    def _gather(self, pair: Pair) -> None:
        """A pair under a projector that holds the images; called under the pairing's lock."""
        self._outlets.emit(PairItem(pair.left, pair.right))
        before = self._gatherer.incomplete
        made = self._gatherer.feed(pair.seq, pair.left.t_exposure_ns, pair)
        self._incomplete(self._gatherer.incomplete - before)
        if made is not None and not self._lost_count():
            self._whole(ImageSet(made, self.mode))

    def _lost_count(self) -> bool:
        """Whether nobody knows any longer which stored image a trigger shows."""
        return self._gatherer.restarts > 0 or self._outlets.counter_restarts() > 0

    def _new_gatherer(self) -> SetAssembler[Pair]:
        frames = 1 if self.plan is None else len(self.plan.sequence)
        return SetAssembler(frames, self._config.sequence.first_trigger)

    def _store(self, plan: ModePlan) -> None:
        """Give a projector that can be told its images what it is to hold; others hold them already."""
        store: Any = getattr(self._rig.projector, "store", None)
        if store is not None:
            store(plan.images, self._config.sequence.first_trigger)

    def _first_image(self, plan: ModePlan | None) -> NDArray[np.uint8]:
        rig = self._rig
        return rig.pattern.image(rig.calibration.response) if plan is None else plan.images[0]

    def _show_first(self, plan: ModePlan | None) -> None:
        self._rig.projector.show(self._first_image(plan))
        self._lit_ns = self._clock.realtime_ns() + self._settle_ns()

    def _settle_ns(self) -> int:
        told_ms = self._config.sequence.settle_ms
        if told_ms is not None:
            return round(1e6 * told_ms)
        tolerance_ns = round(1000 * self._config.pairing.tolerance_us)
        return settling_ns(self._rig.projector, self._refresh_hz, tolerance_ns=tolerance_ns)

    def _shooting(self, box: LatestWinsQueue[Pair], cancelled: Callable[[], bool]) -> ConfirmedCapture:
        return ConfirmedCapture(
            self._rig.projector,
            box,
            clock=self._clock,
            settle_ns=self._settle_ns(),
            patience_s=patience_s(rendered=self._rig.next_pose is not None),
            cancelled=cancelled,
        )
