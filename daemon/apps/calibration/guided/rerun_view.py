"""The display of a session in the Rerun viewer: images with marks, coverage, the next pose, and figures.

    images/left, right                 current images, at most 640 pixels wide
    images/.../marks                   detected marks: green in an acceptable observation, else orange
    images/.../covered                 marks of all accepted views
    images/left/next                   outline of the board at the next pose
    figures/sharpness_px/..., saturated/..., motion_px
    now, advice                        text

A thread of its own logs the newest update, so a viewer that hangs does not delay the session.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.apps.calibration.guided.capture_loop import SessionUpdate
from daemon.apps.calibration.guided.pose_overlay import outline, within
from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue

log = logging.getLogger("fringed.calibrate")

Kind = Literal["none", "web", "native"]
WIDTH_PX = 640
_GOOD, _POOR, _COVERED, _NEXT = [80, 220, 100], [255, 160, 40], [70, 130, 255], [255, 240, 80]
_JOIN_S = 3.0


class RerunDisplay:
    """A display that logs to a Rerun recording.

    Args:
        recording: a ``rerun.RecordingStream``.
    """

    def __init__(self, recording: Any) -> None:
        from daemon.apps.viewer.rerun_import import rerun

        self._rr, self._recording = rerun(), recording
        self._queue: LatestWinsQueue[SessionUpdate] = LatestWinsQueue(1)
        self._covered = -1
        self._logged = 0
        recording.send_blueprint(_blueprint())
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    def show(self, update: SessionUpdate) -> None:
        """Queue the update for logging; a newer one replaces it."""
        self._queue.put(update)

    def capturing(self, completed: int, total: int) -> None:
        """The terminal shows the progress."""

    def failure(self, text: str) -> None:
        """The terminal shows the reason."""

    def close(self) -> None:
        """Log the queued update; a viewer that hangs is abandoned after three seconds."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while True:
            update = self._queue.get(0.1)
            if update is not None:
                try:
                    self._log(update)
                except Exception:  # a failing viewer must not end the session
                    log.exception("the viewer did not accept an image")
            elif self._closing.is_set():
                return

    def _log(self, update: SessionUpdate) -> None:
        rr, session = self._rr, update.session
        self._recording.set_time("observation", sequence=self._logged)
        self._logged += 1
        changed = self._covered != len(session.views)
        self._covered = len(session.views)
        good = update.instruction.steady > 0 or update.instruction.accepted is not None
        for side, image in update.images.items():
            small, scale = downscale(image)
            self._recording.log(f"images/{side}", rr.Image(small))
            detection = update.observation.detections.get(side)
            pixels = detection.marks.pixels * scale if detection is not None else np.zeros((0, 2))
            self._points(f"images/{side}/marks", pixels, _GOOD if good else _POOR, 2.5)
            if changed:
                accepted = [view.marks[side].pixels * scale for view in session.views if side in view.marks]
                covered = np.concatenate(accepted) if accepted else np.zeros((0, 2))
                self._points(f"images/{side}/covered", covered, _COVERED, 1.5)
            if detection is not None:
                self._figure(f"sharpness_px/{side}", detection.sharpness_px)
                self._figure(f"saturated/{side}", detection.saturated)
        if changed:
            self._overlay(update)
            self._advice(update)
        if update.instruction.motion_px is not None:
            self._figure("motion_px", update.instruction.motion_px)
        self._recording.log("now", rr.TextDocument(f"### {update.instruction.text}", media_type="text/markdown"))

    def _overlay(self, update: SessionUpdate) -> None:
        session = update.session
        size = session.sizes["left"]
        scale = min(1.0, WIDTH_PX / size[0])
        corners = outline(session.board, session.advice.next_pose, size, distance_mm=session.usual_distance_mm)
        corners = within(corners, size)
        strips = self._rr.LineStrips2D([corners * scale], colors=[_NEXT], radii=[2.0])
        self._recording.log("images/left/next", strips)

    def _advice(self, update: SessionUpdate) -> None:
        self._recording.log("advice", self._rr.TextDocument(advice_text(update), media_type="text/markdown"))

    def _points(self, name: str, pixels: NDArray[np.float64], color: list[int], radius: float) -> None:
        self._recording.log(name, self._rr.Points2D(pixels, colors=[color], radii=[radius]))

    def _figure(self, name: str, value: float) -> None:
        self._recording.log(f"figures/{name}", self._rr.Scalars(float(value)))


def advice_text(update: SessionUpdate) -> str:
    """The accepted views, the coverage and the missing views as Markdown."""
    session, advice = update.session, update.session.advice
    covered = ", ".join(f"{name} {share:.0%}" for name, share in advice.coverage.items())
    lines = [
        f"**{len(session.views)} of {session.limits.least} views**",
        f"next: {advice.next_pose.text}",
        f"covered: {covered}" if covered else "",
        f"tilts: {advice.tilt_x_deg[0]:.0f} to {advice.tilt_x_deg[1]:.0f} degrees about the horizontal axis, "
        f"{advice.tilt_y_deg[0]:.0f} to {advice.tilt_y_deg[1]:.0f} about the vertical one",
        *(f"- {lack}" for lack in session.missing),
    ]
    return "\n\n".join(line for line in lines if line)


def downscale(image: NDArray[Any]) -> tuple[NDArray[np.uint8], float]:
    """Convert an image to 8 bits and at most 640 pixels of width; also returns the scale."""
    small: Any = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    scale = min(1.0, WIDTH_PX / small.shape[1])
    if scale < 1:
        size = (WIDTH_PX, max(1, round(small.shape[0] * scale)))
        small = cv2.resize(np.ascontiguousarray(small), size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small), scale


@contextmanager
def live_view(kind: Kind, notify: Callable[[str], None]) -> Iterator[RerunDisplay | None]:
    """Open a display in a viewer; None without one, or if it does not start: the session continues without it.

    Args:
        notify: called with the address of a web viewer, or with the reason for a missing viewer.
    """
    with ExitStack() as stack:
        yield None if kind == "none" else _open(kind, stack, notify)


def _open(kind: Kind, stack: ExitStack, notify: Callable[[str], None]) -> RerunDisplay | None:
    try:
        from daemon.apps.viewer import rerun_targets

        if kind == "web":
            recording, address = stack.enter_context(rerun_targets.web_recording(web_port=None, grpc_port=None))
            notify(f"live view: {address}")
        else:
            recording, _ = stack.enter_context(rerun_targets.native_recording())
        display = RerunDisplay(recording)
    except (DaemonError, ImportError, OSError, RuntimeError) as error:
        notify(f"no live view: {error}")
        return None
    stack.callback(display.close)
    return display


def _blueprint() -> Any:
    import rerun.blueprint as rrb

    images = rrb.Horizontal(*(rrb.Spatial2DView(origin=f"images/{side}", name=side) for side in ("left", "right")))
    text = rrb.Vertical(
        rrb.TextDocumentView(origin="now", name="now"),
        rrb.TextDocumentView(origin="advice", name="views"),
        row_shares=[0.45, 0.55],
    )
    figures = [
        rrb.TimeSeriesView(origin=f"figures/{name}", name=title)
        for name, title in (
            ("sharpness_px", "edges, px"), ("saturated", "saturated, share"), ("motion_px", "motion, px"),
        )
    ]  # fmt: skip
    lower = rrb.Horizontal(text, *figures, column_shares=[2, 1, 1, 1])
    return rrb.Blueprint(
        rrb.Vertical(images, lower, row_shares=[0.65, 0.35]),
        rrb.TimePanel(state="collapsed", timeline="observation", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        collapse_panels=True,
    )
