"""The other answers of control: identity, settings, takes, captures."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct


class Hello(Struct, frozen=True, kw_only=True):
    """Identity of a daemon."""

    program: Annotated[str, Meta(description="fringed")]
    version: Annotated[str, Meta(description="of the program")]
    protocol: Annotated[int, Meta(description="version of the protocol, 1")]
    device: Annotated[str, Meta(description="name of the rig")]
    session: Annotated[str, Meta(description="unique for each start of the daemon")]
    stream: Annotated[list[str], Meta(description="addresses of the stream for this machine")]
    remote: Annotated[list[str], Meta(description="addresses of the stream for other machines, with keys")] = []
    shared: Annotated[bool, Meta(description="clouds are in shared memory for programs on this machine")] = False
    rig: Annotated[str | None, Meta(description="path of rig.yaml on the daemon's machine")] = None
    methods: Annotated[list[str], Meta(description="names of all methods")]


class Setting(Struct, frozen=True, kw_only=True):
    """A setting: value, bounds and meaning; a key is absent where it does not apply."""

    path: Annotated[str, Meta(description="names of section and setting, joined by dots")]
    value: Annotated[Any, Meta(description="now")]
    live: Annotated[bool, Meta(description="changes without a restart")]
    type: Annotated[str, Meta(description="of JSON; several are joined by or")]
    doc: Annotated[str, Meta(description="meaning")] = ""
    unit: Annotated[str | None, Meta(description="unit")] = None
    default: Annotated[Any, Meta(description="value without an entry in rig.yaml")] = None
    min: Annotated[float | None, Meta(description="least value")] = None
    max: Annotated[float | None, Meta(description="greatest value")] = None
    above: Annotated[float | None, Meta(description="lower bound that is not allowed itself")] = None
    below: Annotated[float | None, Meta(description="upper bound that is not allowed itself")] = None
    choices: Annotated[list[Any] | None, Meta(description="allowed values")] = None
    pattern: Annotated[str | None, Meta(description="regular expression of a text")] = None
    by_file: Annotated[bool, Meta(description="changes by rig.yaml and reload only")] = False
    least_items: Annotated[int | None, Meta(description="least length of a list")] = None
    most_items: Annotated[int | None, Meta(description="greatest length of a list")] = None


class Settings(Struct, frozen=True, kw_only=True):
    """Settings with their descriptions."""

    settings: Annotated[list[Setting], Meta(description="in the order of rig.yaml")]


class Changed(Struct, frozen=True, kw_only=True):
    """What a reload changed."""

    changed: Annotated[list[str], Meta(description="paths of the settings")]
    restart: Annotated[list[str], Meta(description="empty: a reload that needs a restart is refused")]


class State(Struct, frozen=True, kw_only=True):
    """State after start or stop."""

    state: Annotated[str, Meta(description="as in the status")]


class Snapshot(Struct, frozen=True, kw_only=True):
    """A cloud that was written as .npz: xyz, sigma_mm, gray."""

    file: Annotated[str, Meta(description="its path on the daemon's machine")]
    seq: Annotated[int, Meta(description="number of its trigger")]
    t_ns: Annotated[int, Meta(description="start of exposure, CLOCK_REALTIME")]
    points: Annotated[int, Meta(description="valid points")]


class TakeEntry(Struct, frozen=True, kw_only=True):
    """A take in the directory of the daemon."""

    name: Annotated[str, Meta(description="of its first file, without suffix")]
    state: Annotated[str, Meta(description="whole, writing, unfinished or damaged")]
    files: Annotated[int, Meta(description="number of parts")]
    bytes: Annotated[int, Meta(description="size of all parts")]
    frames: Annotated[list[int], Meta(description="left, right")]
    start_ns: Annotated[int, Meta(description="first exposure, CLOCK_REALTIME; 0 without a frame")]
    end_ns: Annotated[int, Meta(description="last exposure")]
    duration_s: Annotated[float, Meta(description="between them, s")]
    session: Annotated[str, Meta(description="of the daemon that wrote it")]
    device: Annotated[str, Meta(description="name of the rig")]
    interruptions: Annotated[int, Meta(description="parts that continue an interrupted one")]
    problems: Annotated[list[str], Meta(description="at most three")]


class Takes(Struct, frozen=True, kw_only=True):
    """The takes of a directory, oldest first, at most the 1000 newest."""

    directory: Annotated[str, Meta(description="path on the daemon's machine")]
    takes: Annotated[list[TakeEntry], Meta(description="the takes")]
    garbage: Annotated[dict[str, str], Meta(description="files with the suffix of a take that are none, and why")]


class Shown(Struct, frozen=True, kw_only=True):
    """What the projector shows."""

    shown: Annotated[str, Meta(description="fringe, white, black, red, green or blue")]


class Job(Struct, frozen=True, kw_only=True):
    """A capture that was started."""

    job: Annotated[int, Meta(description="its number")]
    frames: Annotated[int, Meta(description="images of the sequence")]
    bytes: Annotated[int, Meta(description="memory that it needs")]


class Capture(Struct, frozen=True, kw_only=True):
    """The newest capture for a calibration."""

    state: Annotated[str, Meta(description="idle, capturing or holding")]
    job: Annotated[int, Meta(description="its number, 0 without one")]
    done: Annotated[int, Meta(description="images captured")]
    of: Annotated[int, Meta(description="images of the capture")]
    outcome: Annotated[str, Meta(description="done, cancelled, failed; empty while it runs")]
    file: Annotated[str | None, Meta(description="the take, on the daemon's machine")]
    problem: Annotated[str | None, Meta(description="why it failed")]
    projector: Annotated[list[int] | None, Meta(description="width and height, pixels; calibrate.status only")] = None
    hand: Annotated[bool | None, Meta(description="whether a hand is simulated; calibrate.status only")] = None


class Pose(Struct, frozen=True, kw_only=True):
    """Pose of a simulated board."""

    pose: Annotated[int | None, Meta(description="its number, null after the last one")]
