"""A session in the Rerun viewer: images with the marks, what is covered, the pose to show next, and figures.

    images/left, right                 what the camera sees, at most 640 pixels wide
    images/.../marks                   found now: green where the look is good, orange where it is not
    images/.../covered                 marks of all views taken
    images/left/next                   outline of the board at the pose to show next
    figures/sharpness_px/..., saturated/..., motion_px
    advice                               words

Everything is logged from a thread of its own that always takes the newest: a viewer that hangs holds up nothing.
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

from daemon.apps.calibration.guided.capture_loop import Scene
from daemon.apps.calibration.guided.pose_overlay import outline, within
from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue

log = logging.getLogger("fringed.calibrate")

Kind = Literal["none", "web", "native"]
WIDTH_PX = 640
_GOOD, _POOR, _COVERED, _NEXT = [80, 220, 100], [255, 160, 40], [70, 130, 255], [255, 240, 80]
_JOIN_S = 3.0


class Shown:
    """A watcher that logs to a recording.

    Args:
        recording: a ``rerun.RecordingStream``.
    """

    def __init__(self, recording: Any) -> None:
        from daemon.apps.viewer.rerun_import import rerun

        self._rr, self._recording = rerun(), recording
        self._box: LatestWinsQueue[Scene] = LatestWinsQueue(1)
        self._covered = -1
        self._looks = 0
        recording.send_blueprint(_blueprint())
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    def seen(self, scene: Scene) -> None:
        """Log it soon, unless a newer one comes first."""
        self._box.put(scene)

    def capturing(self, done: int, of: int) -> None:
        """The terminal tells it."""

    def trouble(self, text: str) -> None:
        """The terminal tells it."""

    def close(self) -> None:
        """Log what waits; a viewer that hangs is left behind."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while True:
            scene = self._box.get(0.1)
            if scene is not None:
                try:
                    self._log(scene)
                except Exception:  # a viewer's trouble is not the session's
                    log.exception("the viewer does not take an image")
            elif self._closing.is_set():
                return

    def _log(self, scene: Scene) -> None:
        rr, session = self._rr, scene.session
        self._recording.set_time("look", sequence=self._looks)
        self._looks += 1
        again = self._covered != len(session.views)
        self._covered = len(session.views)
        good = scene.told.steady > 0 or scene.told.accepted is not None
        for side, image in scene.images.items():
            small, scale = shrunk(image)
            self._recording.log(f"images/{side}", rr.Image(small))
            found = scene.sight.found.get(side)
            pixels = found.marks.pixels * scale if found is not None else np.zeros((0, 2))
            self._points(f"images/{side}/marks", pixels, _GOOD if good else _POOR, 2.5)
            if again:
                taken = [view.marks[side].pixels * scale for view in session.views if side in view.marks]
                covered = np.concatenate(taken) if taken else np.zeros((0, 2))
                self._points(f"images/{side}/covered", covered, _COVERED, 1.5)
            if found is not None:
                self._figure(f"sharpness_px/{side}", found.sharpness_px)
                self._figure(f"saturated/{side}", found.saturated)
        if again:
            self._ghost(scene)
            self._advice(scene)
        if scene.told.motion_px is not None:
            self._figure("motion_px", scene.told.motion_px)
        self._recording.log("now", rr.TextDocument(f"### {scene.told.text}", media_type="text/markdown"))

    def _ghost(self, scene: Scene) -> None:
        session = scene.session
        size = session.sizes["left"]
        scale = min(1.0, WIDTH_PX / size[0])
        wished = outline(session.board, session.advice.next_pose, size, distance_mm=session.usual_distance_mm)
        wished = within(wished, size)
        strips = self._rr.LineStrips2D([wished * scale], colors=[_NEXT], radii=[2.0])
        self._recording.log("images/left/next", strips)

    def _advice(self, scene: Scene) -> None:
        self._recording.log("advice", self._rr.TextDocument(advice_text(scene), media_type="text/markdown"))

    def _points(self, name: str, pixels: NDArray[np.float64], color: list[int], radius: float) -> None:
        self._recording.log(name, self._rr.Points2D(pixels, colors=[color], radii=[radius]))

    def _figure(self, name: str, value: float) -> None:
        self._recording.log(f"figures/{name}", self._rr.Scalars(float(value)))


def advice_text(scene: Scene) -> str:
    """What there is and what is missing, as Markdown."""
    session, advice = scene.session, scene.session.advice
    covered = ", ".join(f"{name} {share:.0%}" for name, share in advice.coverage.items())
    lines = [
        f"**{len(session.views)} of {session.limits.wanted} views**",
        f"next: {advice.next_pose.text}",
        f"covered: {covered}" if covered else "",
        f"tilts: {advice.tilt_x_deg[0]:.0f} to {advice.tilt_x_deg[1]:.0f} degrees about the horizontal axis, "
        f"{advice.tilt_y_deg[0]:.0f} to {advice.tilt_y_deg[1]:.0f} about the vertical one",
        *(f"- {lack}" for lack in session.missing),
    ]
    return "\n\n".join(line for line in lines if line)


def shrunk(image: NDArray[Any]) -> tuple[NDArray[np.uint8], float]:
    """8-bit image of at most 640 pixels of width, and its scale."""
    small: Any = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    scale = min(1.0, WIDTH_PX / small.shape[1])
    if scale < 1:
        size = (WIDTH_PX, max(1, round(small.shape[0] * scale)))
        small = cv2.resize(np.ascontiguousarray(small), size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small), scale


@contextmanager
def viewer(kind: Kind, notify: Callable[[str], None]) -> Iterator[Shown | None]:
    """A watcher behind a viewer of that kind; None without one, also where it does not start: the session goes on.

    Args:
        notify: called with the address of a web viewer, or with the reason why there is none.
    """
    with ExitStack() as stack:
        yield None if kind == "none" else _opened(kind, stack, notify)


def _opened(kind: Kind, stack: ExitStack, notify: Callable[[str], None]) -> Shown | None:
    try:
        from daemon.apps.viewer import rerun_targets

        if kind == "web":
            recording, address = stack.enter_context(rerun_targets.web_recording(web_port=None, grpc_port=None))
            notify(f"live view: {address}")
        else:
            recording, _ = stack.enter_context(rerun_targets.native_recording())
        shown = Shown(recording)
    except (DaemonError, ImportError, OSError, RuntimeError) as error:
        notify(f"no live view: {error}")
        return None
    stack.callback(shown.close)
    return shown


def _blueprint() -> Any:
    import rerun.blueprint as rrb

    images = rrb.Horizontal(*(rrb.Spatial2DView(origin=f"images/{side}", name=side) for side in ("left", "right")))
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="now", name="now"),
        rrb.TextDocumentView(origin="advice", name="views"),
        row_shares=[0.45, 0.55],
    )
    figures = [
        rrb.TimeSeriesView(origin=f"figures/{name}", name=title)
        for name, title in (
            ("sharpness_px", "edges, px"), ("saturated", "clipped, share"), ("motion_px", "motion, px"),
        )
    ]  # fmt: skip
    lower = rrb.Horizontal(words, *figures, column_shares=[2, 1, 1, 1])
    return rrb.Blueprint(
        rrb.Vertical(images, lower, row_shares=[0.65, 0.35]),
        rrb.TimePanel(state="collapsed", timeline="look", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        collapse_panels=True,
    )
