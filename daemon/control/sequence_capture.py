"""Capture of sequences: the daemon projects images instead of its fringe and writes the captured pairs as a take.

    idle --start--> capturing --> holding --start--> capturing ...
      ^                              |
      +------- hold over, cancel ----+     the fringe is shown again, and measuring resumes

While it captures or holds, nothing is measured or recorded. Both end without a client: a capture whose status is not
polled is cancelled, and a hold has a time limit.
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
from daemon.live.items import Pair, Sink
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
"""A capture whose status has not been polled for this long has lost its client."""

_SMALL_BYTES = 64 << 20
_KEPT = 4
_TICK_S = 0.1
_DISK_S = 20.0

OpenTake = Callable[[Path, Mapping[str, Any], int], Sink]


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """A sequence to capture.

    Args:
        sequence: of projected images; response: of the projector, for images that are given as light.
        pairs: passes through the sequence; hold_s: how long the last image stays afterwards, for the next request.
    """

    sequence: FrameSequence
    pairs: int = 1
    hold_s: float = 0.0
    response: Response | None = None


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a job; ``outcome`` is empty while it runs, then ``done``, ``failed`` or ``cancelled``."""

    job: int = 0
    done: int = 0
    of: int = 0
    outcome: str = ""
    file: str = ""
    problem: str = ""


class Capture:
    """Executes one capture request at a time in a thread of its own.

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
        self._exclusive = threading.Lock()  # a new thread begins only when the one before has cleaned up
        self._thread: threading.Thread | None = None
        self._request: CaptureRequest | None = None
        self._progress = Progress()
        self._cancelled = self._resuming = False
        self._polled_ns = self._hold_until_ns = 0

    @property
    def active(self) -> bool:
        """Whether a capture uses the projector."""
        return self._thread is not None or self._exclusive.locked()

    def start(self, request: CaptureRequest) -> dict[str, Any]:
        """Begin a capture; return the number of the job.

        Raises:
            DaemonError: another one is running, this one is too large, or the daemon is still starting.
        """
        if not self._service.ready:
            raise DaemonError("the daemon is still starting; try again when it is running")
        size = self._bytes(request)
        if size > MOST_BYTES:
            raise DaemonError(
                f"{len(request.sequence)} frames with {request.pairs} pairs are {size >> 20} MB, "
                f"limit {MOST_BYTES >> 20}; capture fewer at a time"
            )
        with self._changed:
            if self._busy():
                raise DaemonError(
                    f"capture {self._progress.job} is running; wait for it (calibrate.status) or end it "
                    "(calibrate.cancel)"
                )
            self._request, self._cancelled = request, False
            self._polled_ns = self._now_ns()
            self._progress = Progress(self._progress.job + 1, of=len(request.sequence) * request.pairs)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
                self._thread.start()
            self._changed.notify_all()
            return {"job": self._progress.job, "frames": len(request.sequence), "bytes": size}

    def status(self) -> dict[str, Any]:
        """Return the state and the newest job."""
        with self._changed:
            self._polled_ns = self._now_ns()
            progress = self._progress
            state = "capturing" if self._busy() else "holding" if self._thread is not None else "idle"
            return {
                "state": state,
                "job": progress.job,
                "done": progress.done,
                "of": progress.of,
                "outcome": progress.outcome,
                "file": progress.file or None,
                "problem": progress.problem or None,
            }

    def cancel(self) -> dict[str, Any]:
        """End a capture or a hold soon; measuring then resumes."""
        with self._changed:
            self._cancelled = True
            self._hold_until_ns = 0
            self._changed.notify_all()
        return self.status()

    def close(self, timeout_s: float = 10.0) -> None:
        """End the capture and remove the files that are kept in memory."""
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

    def _bytes(self, request: CaptureRequest) -> int:
        total = 0
        for side in SIDES:
            camera = self._service.cameras[side].status
            if camera.encoding not in ENCODINGS:
                raise DaemonError(f"camera {side} is not open yet; try again when the daemon is running")
            dtype, channels = ENCODINGS[camera.encoding]
            total += camera.size[0] * camera.size[1] * channels * int(dtype[-1])
        return total * len(request.sequence) * request.pairs

    def _run(self) -> None:
        with self._exclusive:
            pairs: LatestWinsQueue[Pair] = LatestWinsQueue(4)
            capture: ConfirmedCapture | None = None
            self._resuming = False
            try:
                self._service.divert(pairs.put)
                capture = self._confirmed_capture(pairs)
                while (request := self._next()) is not None:
                    self._execute(request, capture)
            except Exception as error:
                log.warning("capture: %s", error)
                with self._changed:
                    self._thread = self._request = None
                self._finish("failed", problem=str(error))
            finally:
                self._resume_measuring(capture)

    def _confirmed_capture(self, pairs: LatestWinsQueue[Pair]) -> ConfirmedCapture:
        service = self._service
        info = service.projector
        if info is None:
            raise DaemonError("the daemon is still starting; try again when it is running")
        tolerance_ns = round(1000 * service.config.pairing.tolerance_us)
        settle_ns = settling_ns(info, tolerance_ns=tolerance_ns)
        return ConfirmedCapture(
            service.rig.projector,
            info,
            pairs,
            clock=service.clock,
            settle_ns=settle_ns,
            patience_s=patience_s(rendered=service.rig.board is not None),
            cancelled=self._give_up,
        )

    def _give_up(self) -> bool:
        abandoned = self._now_ns() - self._polled_ns > ABANDONED_S * 1e9
        return self._service.stopping or (not self._resuming and (self._cancelled or abandoned))

    def _next(self) -> CaptureRequest | None:
        """Return the next request, or None once the hold is over."""
        with self._changed:
            while self._request is None:
                if self._now_ns() >= self._hold_until_ns or self._service.stopping:
                    # From here on a request starts a new thread.
                    self._thread = None
                    return None
                self._changed.wait(_TICK_S)
            request, self._request = self._request, None
            return request

    def _execute(self, request: CaptureRequest, capture: ConfirmedCapture) -> None:
        path, sink = None, None
        try:
            path, sink = self._open(request)
            self._write(request, capture, sink)
            sink.close()
            written = sink.status()
            if written.get("problem") or any(written.get("dropped", {}).values()):
                raise DaemonError(str(written.get("problem") or f"{path}: not everything was written"))
            self._hold_until_ns = self._now_ns() + round(1e9 * request.hold_s)
            self._finish("done", file=str(path))
        except Exception as error:  # measuring resumes after any error
            outcome = "cancelled" if isinstance(error, CaptureCancelledError) else "failed"
            log.warning("capture %d %s: %s", self._progress.job, outcome, error)
            if sink is not None:
                sink.close()
            if path is not None:
                self._discard(path)
            # A failed request may be repeated during the hold; a cancelled one ends it.
            self._hold_until_ns = self._now_ns() + (round(1e9 * request.hold_s) if outcome == "failed" else 0)
            self._finish(outcome, problem=str(error))

    def _open(self, request: CaptureRequest) -> tuple[Path, Sink]:
        size = self._bytes(request)
        small = size <= _SMALL_BYTES and _free(self._small) > 4 * size + (8 << 20)
        directory = self._small if small else self._large
        directory.mkdir(parents=True, exist_ok=True)
        stamp = datetime.fromtimestamp(self._service.clock.realtime_ns() / 1e9, tz=UTC)
        path = directory / f"capture{self._progress.job:05d}_{stamp:%Y%m%dT%H%M%S}_{stamp.microsecond // 1000:03d}.mcap"
        kept = self._kept[directory]
        while len(kept) >= _KEPT:
            kept.popleft().unlink(missing_ok=True)
        least = 4 << 20 if small else self._service.config.recording.min_free_mb * 1_000_000
        sink = self._open_take(path, request.sequence.as_mapping(), least)
        kept.append(path)
        return path, sink

    def _discard(self, path: Path) -> None:
        for file in (path, path.with_name(path.name + ".partial")):
            file.unlink(missing_ok=True)
        for kept in self._kept.values():
            if path in kept:
                kept.remove(path)

    def _write(self, request: CaptureRequest, capture: ConfirmedCapture, sink: Sink) -> None:
        """Write the pairs, numbered in their order: frame i of pass k is ``k * frames + i``; a pass is a view."""
        frames = request.sequence.frames
        images = (frame.image(request.response) for _ in range(request.pairs) for frame in frames)
        for number, pair in enumerate(capture.each(images)):
            item = pair.renumbered(number)
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

    def _resume_measuring(self, capture: ConfirmedCapture | None) -> None:
        """Show the fringe, and let pairs through once one shows it."""
        rig = self._service.rig
        try:
            if capture is not None and not self._service.stopping:
                self._resuming = True
                capture.reset()
                capture.show(rig.pattern.image(rig.calibration.response))
                capture.pair()
        except Exception as error:  # a lost camera, for example, which the status reports
            log.warning("capture: the fringe is not detected again yet: %s", error)
        finally:
            self._service.divert(None)


def _free(directory: Path) -> int:
    try:
        return shutil.disk_usage(directory).free
    except OSError:
        return 0
