"""The methods of control: parameters, results, roles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from fringed.protocol import answers
from fringed.protocol.health import Event, Health, History
from fringed.protocol.status import Mode, Recorder, Status


class Parameters(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters of a method, in the order of parameters by position; unknown ones are refused."""


class Get(Parameters, frozen=True, kw_only=True):
    """Of ``get``."""

    path: Annotated[str, Meta(description="of a setting or a section; empty: all")] = ""
    detail: Annotated[bool, Meta(description="rows with bounds, unit and meaning instead of values")] = False


class Set(Parameters, frozen=True, kw_only=True):
    """Of ``set``."""

    path: Annotated[str, Meta(description="of a setting")]
    value: Annotated[Any, Meta(description="checked by the rules of rig.yaml")]


class Named(Parameters, frozen=True, kw_only=True):
    """Of ``snapshot``."""

    name: Annotated[str | UnsetType, Meta(description="beginning of the file's name: letters, digits, . _ -")] = UNSET


class Record(Parameters, frozen=True, kw_only=True):
    """Of ``record.start``."""

    name: Annotated[str, Meta(description="beginning of the file's name: letters, digits, . _ -")] = "take"
    before_s: Annotated[float, Meta(ge=0, le=3600, description="begin so long ago, from recording.before_s")] = 0.0


class Show(Parameters, frozen=True, kw_only=True):
    """Of ``pattern.show``."""

    name: Annotated[str, Meta(description="fringe, white, black, red, green or blue")] = "fringe"


class SetMode(Parameters, frozen=True, kw_only=True):
    """Of ``pattern.mode``."""

    name: Annotated[str | UnsetType, Meta(description="single, two_color, heterodyne or gray; absent: no change")] = (
        UNSET
    )


class StartCapture(Parameters, frozen=True, kw_only=True):
    """Of ``calibrate.capture``."""

    frames: Annotated[list[dict[str, Any]], Meta(min_length=1, max_length=512, description="pattern descriptions")]
    pairs: Annotated[int, Meta(ge=1, description="passes through them")] = 1
    hold_s: Annotated[float, Meta(ge=0, description="how long the last image stays")] = 0
    name: Annotated[str | UnsetType, Meta(description="of the sequence")] = UNSET
    response: Annotated[dict[str, Any] | None, Meta(description="levels, red, green and blue of the projector")] = None


class EventsOf(Parameters, frozen=True, kw_only=True):
    """Of ``health.events``."""

    most: Annotated[float, Meta(ge=1, le=1000, description="number of events")] = 100


class HistoryOf(Parameters, frozen=True, kw_only=True):
    """Of ``health.history``."""

    quantities: Annotated[
        list[str], Meta(min_length=1, max_length=8, description="names, see docs/reference/health.md")
    ]
    seconds: Annotated[float, Meta(ge=10, le=259200, description="how far back")] = 3600
    points: Annotated[float, Meta(ge=2, le=600, description="number of intervals at most")] = 300


@dataclass(frozen=True, slots=True)
class Method:
    """A method.

    Args:
        params, result: types; role: that a key needs, ``view`` or ``operate``.
        background: may wait for the pipeline or a disk; one at a time, at most eight wait.
    """

    name: str
    text: str
    result: Any
    params: type[Parameters] = Parameters
    role: str = "operate"
    background: bool = False


METHODS = (
    Method("hello", "identity of the daemon", answers.Hello, role="view"),
    Method("status", "the status", Status, role="view"),
    Method("get", "a value, a section as nested values, or rows", Any, Get, role="view"),
    Method("set", "change a live setting; its new value by path", dict[str, Any], Set, background=True),
    Method("reload", "apply rig.yaml and its files again, all or nothing", answers.Changed, background=True),
    Method("start", "resume measuring", answers.State),
    Method("stop", "pause measuring; everything stays connected", answers.State),
    Method("snapshot", "write the newest cloud", answers.Snapshot, Named, background=True),
    Method("record.start", "begin a take", Recorder, Record, background=True),
    Method("record.stop", "end the take; complete on the disk when it returns", Recorder, background=True),
    Method("takes.list", "the takes of the directory", answers.Takes, role="view", background=True),
    Method("pattern.show", "project the fringe or a plain image", answers.Shown, Show, background=True),
    Method("pattern.mode", "the mode; with a name, set it first", Mode, SetMode, background=True),
    Method("health", "verdict, quantities and limits", Health, role="view"),
    Method("health.events", "newest events, oldest first", list[Event], EventsOf, role="view"),
    Method("health.history", "quantities over time", History, HistoryOf, role="view"),
    Method("calibrate.capture", "project a sequence and capture it", answers.Job, StartCapture),
    Method("calibrate.status", "progress of the newest capture", answers.Capture),
    Method("calibrate.cancel", "end a capture", answers.Capture),
    Method("calibrate.next_pose", "move the board of a simulated rig", answers.Pose, background=True),
)
