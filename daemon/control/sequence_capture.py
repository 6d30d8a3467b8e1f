"""Captured sequences: the daemon shows images instead of its fringe and writes what the cameras saw as a take.

    idle --start--> capturing --> holding --start--> capturing ...
      ^                              |
      +------- hold over, cancel ----+     the fringe is shown again, and the daemon measures as before

While it captures or holds, nothing is measured or recorded. Nothing lasts without somebody who asks for it: a capture
that nobody asks about is given up, and a hold ends by itself.
"""

from __future__ import annotations

import logging
import shutil
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.live.acquisition.pairer import Pair
from daemon.live.items import PairItem, Sink
from daemon.live.projection.confirmed_capture import CaptureCancelledError, ConfirmedCapture, patience_s, settling_ns
from daemon.live.service import Service
from daemon.recording.format.raw_image import ENCODINGS
from drivers.protocols import SIDES
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.calibration import Response

log = logging.getLogger("fringed.capture")

MOST_PAIRS, LONGEST_HOLD_S = 64, 60.0
MOST_BYTES = 4 << 30
ABANDONED_S = 15.0
"""A capture whose status nobody asks for so long has lost its client."""

_SMALL_BYTES = 64 << 20
_KEPT = 4
_TICK_S = 0.1
_DISK_S = 20.0

OpenTake = Callable[[Path, Mapping[str, Any], int], Sink]


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be captured.

    Args:
        sequence: what is shown; response: of the projector, for images that are given as light.
        pairs: how often it is gone through; hold_s: how long the last image stays afterwards, for the next order.
    """

    sequence: FrameSequence
    pairs: int = 1
    hold_s: float = 0.0
    response: Response | None = None


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is; ``outcome`` is empty while it goes on, then ``done``, ``failed`` or ``cancelled``."""

    job: int = 0
    done: int = 0
    of: int = 0
    outcome: str = ""
    file: str = ""
    problem: str = ""


class Capture:
    """Takes one order at a time and carries it out in a thread of its own.

    Args:
        service: whose pairs and projector are used.
        open_take: makes the writer of a take from its path, the sequence and the free space that must stay, bytes.
        directories: for captures up to 64 MiB (in memory, if that can be), and for larger ones. The last four captures
            are kept in each.
    """

    def __init__(self, service: Service, open_take: OpenTake, *, directories: tuple[Path, Path]) -> None:
        self._service, self._open_take = service, open_take
        self._small, self._large = directories
        self._kept: dict[Path, deque[Path]] = {directory: deque() for directory in directories}
        self._changed = threading.Condition()
        self._turn = threading.Lock()  # of the threads: the next one begins when the last one has cleaned up
        self._thread: threading.Thread | None = None
        self._order: Order | None = None
        self._progress = Progress()
        self._cancelled = self._going_back = False
        self._asked_ns = self._hold_until_ns = 0

    @property
    def active(self) -> bool:
        """Whether the projector is not showing the fringe."""
        return self._thread is not None or self._turn.locked()

    def start(self, order: Order) -> dict[str, Any]:
        """Begin; the number of the job is told.

        Raises:
            DaemonError: another one is going on, this one is too large, or the daemon is still starting.
        """
        if not self._service.ready:
            raise DaemonError("the daemon is still starting; try again when it is running")
        size = self._bytes(order)
        if size > MOST_BYTES:
            raise DaemonError(
                f"{len(order.sequence)} frames with {order.pairs} pairs are {size >> 20} MB, limit {MOST_BYTES >> 20}; "
                "capture fewer at a time"
            )
        with self._changed:
            if self._busy():
                raise DaemonError(
                    f"capture {self._progress.job} is going on; wait for it (calibrate.status) or end it "
                    "(calibrate.cancel)"
                )
            self._order, self._cancelled = order, False
            self._asked_ns = self._now_ns()
            self._progress = Progress(self._progress.job + 1, of=len(order.sequence) * order.pairs)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
                self._thread.start()
            self._changed.notify_all()
            return {"job": self._progress.job, "frames": len(order.sequence), "bytes": size}

    def status(self) -> dict[str, Any]:
        """The newest job, and what goes on."""
        with self._changed:
            self._asked_ns = self._now_ns()
            told = self._progress
            state = "capturing" if self._busy() else "holding" if self._thread is not None else "idle"
            return {
                "state": state,
                "job": told.job,
                "done": told.done,
                "of": told.of,
                "outcome": told.outcome,
                "file": told.file or None,
                "problem": told.problem or None,
            }

    def cancel(self) -> dict[str, Any]:
        """End a capture or a hold soon; the daemon then measures again."""
        with self._changed:
            self._cancelled = True
            self._hold_until_ns = 0
            self._changed.notify_all()
        return self.status()

    def close(self, timeout_s: float = 10.0) -> None:
        """End, and remove the captures that are kept in memory."""
        self.cancel()
        thread = self._thread
        if thread is not None:
            thread.join(timeout_s)
        if self._small != self._large:
            for path in self._kept[self._small]:
                path.unlink(missing_ok=True)

    def _busy(self) -> bool:
        return self._progress.job > 0 and not self._progress.outcome

    def _now_ns(self) -> int:
        return self._service.clock.monotonic_ns()

    def _bytes(self, order: Order) -> int:
        total = 0
        for side in SIDES:
            camera = self._service.cameras[side].status
            if camera.encoding not in ENCODINGS:
                raise DaemonError(f"camera {side} is not there yet; try again when the daemon is running")
            dtype, channels = ENCODINGS[camera.encoding]
            total += camera.size[0] * camera.size[1] * channels * int(dtype[-1])
        return total * len(order.sequence) * order.pairs

    def _run(self) -> None:
        with self._turn:
            box: LatestWinsQueue[Pair] = LatestWinsQueue(4)
            shooting: ConfirmedCapture | None = None
            self._going_back = False
            try:
                self._service.divert(box.put)
                shooting = self._shooting(box)
                while (order := self._next()) is not None:
                    self._carry_out(order, shooting)
            except Exception as error:
                log.warning("capture: %s", error)
                with self._changed:
                    self._thread = self._order = None
                self._finish("failed", problem=str(error))
            finally:
                self._measure_again(shooting)

    def _shooting(self, box: LatestWinsQueue[Pair]) -> ConfirmedCapture:
        service = self._service
        projector, refresh_hz = service.rig.projector, service.projector.refresh_hz if service.projector else 0.0
        tolerance_ns = round(1000 * service.config.pairing.tolerance_us)
        settle_ns = settling_ns(projector, refresh_hz, tolerance_ns=tolerance_ns)
        return ConfirmedCapture(
            projector,
            box,
            clock=service.clock,
            settle_ns=settle_ns,
            patience_s=patience_s(rendered=service.rig.next_pose is not None),
            cancelled=self._give_up,
        )

    def _give_up(self) -> bool:
        abandoned = self._now_ns() - self._asked_ns > ABANDONED_S * 1e9
        return self._service.stopping or (not self._going_back and (self._cancelled or abandoned))

    def _next(self) -> Order | None:
        """The next order, or None once the hold is over."""
        with self._changed:
            while self._order is None:
                if self._now_ns() >= self._hold_until_ns or self._service.stopping:
                    # From here on an order starts a new thread.
                    self._thread = None
                    return None
                self._changed.wait(_TICK_S)
            order, self._order = self._order, None
            return order

    def _carry_out(self, order: Order, shooting: ConfirmedCapture) -> None:
        path, sink = None, None
        try:
            path, sink = self._open(order)
            self._write(order, shooting, sink)
            sink.close()
            told = sink.status()
            if told.get("problem") or any(told.get("dropped", {}).values()):
                raise DaemonError(str(told.get("problem") or f"{path}: not everything was written"))
            self._hold_until_ns = self._now_ns() + round(1e9 * order.hold_s)
            self._finish("done", file=str(path))
        except Exception as error:  # whatever it is, the daemon goes back to measuring
            outcome = "cancelled" if isinstance(error, CaptureCancelledError) else "failed"
            log.warning("capture %d %s: %s", self._progress.job, outcome, error)
            if sink is not None:
                sink.close()
            if path is not None:
                self._forget(path)
            # What failed may be tried again at once; what was cancelled is over.
            self._hold_until_ns = self._now_ns() + (round(1e9 * order.hold_s) if outcome == "failed" else 0)
            self._finish(outcome, problem=str(error))

    def _open(self, order: Order) -> tuple[Path, Sink]:
        size = self._bytes(order)
        small = size <= _SMALL_BYTES and _free(self._small) > 4 * size + (8 << 20)
        directory = self._small if small else self._large
        directory.mkdir(parents=True, exist_ok=True)
        stamp = datetime.fromtimestamp(self._service.clock.realtime_ns() / 1e9, tz=UTC)
        path = directory / f"capture{self._progress.job:05d}_{stamp:%Y%m%dT%H%M%S}_{stamp.microsecond // 1000:03d}.mcap"
        kept = self._kept[directory]
        while len(kept) >= _KEPT:
            kept.popleft().unlink(missing_ok=True)
        least = 4 << 20 if small else self._service.config.recording.min_free_mb * 1_000_000
        sink = self._open_take(path, order.sequence.as_mapping(), least)
        kept.append(path)
        return path, sink

    def _forget(self, path: Path) -> None:
        for file in (path, path.with_name(path.name + ".partial")):
            file.unlink(missing_ok=True)
        for kept in self._kept.values():
            if path in kept:
                kept.remove(path)

    def _write(self, order: Order, shooting: ConfirmedCapture, sink: Sink) -> None:
        """The pairs in the order of their numbers: frame i of the k-th pass is ``k * frames + i``, a pass is a view."""
        frames = order.sequence.frames
        images = (frame.image(order.response) for _ in range(order.pairs) for frame in frames)
        for number, pair in enumerate(shooting.each(images)):
            item = PairItem(replace(pair.left, trigger=number), replace(pair.right, trigger=number))
            end_ns = self._now_ns() + round(1e9 * _DISK_S)
            while not sink.offer(item):
                problem = sink.status().get("problem")
                if problem or self._give_up() or self._now_ns() > end_ns:
                    raise DaemonError(str(problem or "the disk does not take the images"))
                with self._changed:
                    self._changed.wait(_TICK_S)
            with self._changed:
                self._progress = replace(self._progress, done=self._progress.done + 1)

    def _finish(self, outcome: str, *, file: str = "", problem: str = "") -> None:
        with self._changed:
            self._progress = replace(self._progress, outcome=outcome, file=file, problem=problem)

    def _measure_again(self, shooting: ConfirmedCapture | None) -> None:
        """Show the fringe, and let pairs through once one has seen it."""
        rig = self._service.rig
        try:
            if shooting is not None and not self._service.stopping:
                self._going_back = True
                shooting.forget()
                shooting.show(rig.pattern.image(rig.calibration.response))
                shooting.pair()
        except Exception as error:  # a camera that is gone, say: the status tells it
            log.warning("capture: the fringe is not seen again yet: %s", error)
        finally:
            self._service.divert(None)


def _free(directory: Path) -> int:
    try:
        return shutil.disk_usage(directory).free
    except OSError:
        return 0
