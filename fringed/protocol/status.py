"""The status of a daemon: the answer of ``status``, and the body of the messages on the topic ``status``."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

Counts = dict[str, int]


class Camera(Struct, frozen=True, kw_only=True):
    """One camera."""

    state: Annotated[str, Meta(description="closed, acquiring, paused or lost")]
    model: Annotated[str, Meta(description="as the device reports it")]
    serial: Annotated[str, Meta(description="serial number")]
    encoding: Annotated[str, Meta(description="rgb8, bayer_rggb8 and the other three, mono8, mono16")]
    size: Annotated[tuple[int, int], Meta(description="width and height, pixels")]
    exposure_us: Annotated[float, Meta(description="exposure time, µs; 0 where it is not known")]
    problem: Annotated[str, Meta(description="why it is lost, empty otherwise")]
    losses: Annotated[int, Meta(description="how often the device was lost")]
    rate_hz: Annotated[float, Meta(description="frames per second")]
    frames: Annotated[int, Meta(description="frames since the start")]
    fates: Annotated[Counts, Meta(description="outcomes of the frames, counted: paired, waiting, ambiguous, ...")]
    driver: Annotated[Counts, Meta(description="the driver's counters, lost frames among them")]
    temperature_c: Annotated[float | None, Meta(description="of the sensor or housing, °C; null where unknown")]


class CalibrationCheck(Struct, frozen=True, kw_only=True):
    """Check of every pair against the calibration."""

    policy: Annotated[str, Meta(description="withhold, warn or off")]
    verdict: Annotated[str, Meta(description="of the last pair: consistent, doubtful, inconsistent or unknown")]
    reason: Annotated[str, Meta(description="why it is inconsistent")]
    readings: Annotated[dict[str, Any], Meta(description="the quantities that were compared")]
    withheld: Annotated[int, Meta(description="clouds that were not published")]


class Recorder(Struct, frozen=True, kw_only=True):
    """The take that is written; only ``recording: false`` without one."""

    recording: Annotated[bool, Meta(description="whether a take is open")]
    file: Annotated[str | None, Meta(description="path of its first part")] = None
    files: Annotated[list[str] | None, Meta(description="paths of its parts")] = None
    parts: Annotated[int | None, Meta(description="number of parts")] = None
    queued: Annotated[int | None, Meta(description="frames that wait for the disk")] = None
    dropped: Annotated[Counts | None, Meta(description="frames that were not written, by reason")] = None
    synced: Annotated[dict[str, Any] | None, Meta(description="what survives a power cut")] = None
    pairs: Annotated[int | None, Meta(description="pairs written")] = None
    lone_frames: Annotated[int | None, Meta(description="frames without a partner written")] = None
    bytes: Annotated[int | None, Meta(description="bytes written")] = None
    problem: Annotated[str | None, Meta(description="why writing is interrupted")] = None
    interruptions: Annotated[int | None, Meta(description="how often writing was interrupted; absent for 0")] = None
    unsynced_pairs: Annotated[int | None, Meta(description="pairs that an error may have lost; absent for 0")] = None
    removed_parts: Annotated[int | None, Meta(description="oldest parts that were removed for space")] = None
    removed_bytes: Annotated[int | None, Meta(description="their size")] = None
    before_items: Annotated[int | None, Meta(description="frames from before the start, in its answer")] = None
    before: Annotated[dict[str, Any] | None, Meta(description="the buffer for takes that begin earlier")] = None


class HealthSummary(Struct, frozen=True, kw_only=True):
    """The verdict of the health monitor; only ``enabled: false`` when it is switched off."""

    enabled: Annotated[bool, Meta(description="whether health is monitored")]
    verdict: Annotated[str | None, Meta(description="healthy, warning, ill or unknown")] = None
    open: Annotated[dict[str, str] | None, Meta(description="limits that are exceeded, at most four")] = None
    open_count: Annotated[int | None, Meta(description="number of exceeded limits")] = None
    events: Annotated[int | None, Meta(description="events since the start")] = None
    metrics: Annotated[str | None, Meta(description="address of the Prometheus metrics")] = None
    failed: Annotated[str | None, Meta(description="why the monitoring itself fails")] = None


class DriftSummary(Struct, frozen=True, kw_only=True):
    """The calibration drift monitor; only ``enabled: false`` when it is switched off."""

    enabled: Annotated[bool, Meta(description="whether drift is monitored")]
    verdict: Annotated[str | None, Meta(description="ok, drifted, learning or not observable")] = None
    problem: Annotated[str | None, Meta(description="what has drifted")] = None
    checked: Annotated[int | None, Meta(description="pairs evaluated")] = None
    ms: Annotated[float | None, Meta(description="time of an evaluation, ms")] = None
    patches: Annotated[int | None, Meta(description="image patches of the last evaluation")] = None
    observables: Annotated[dict[str, Any] | None, Meta(description="verdict, value and limit by name")] = None


class Mode(Struct, frozen=True, kw_only=True):
    """The mode; the other keys in multi-frame modes only."""

    mode: Annotated[str, Meta(description="single, heterodyne, gray or two_color")]
    frames: Annotated[int | None, Meta(description="images of a set")] = None
    display: Annotated[str | None, Meta(description="driven or stored")] = None
    sets: Annotated[int | None, Meta(description="complete sets")] = None
    sets_incomplete: Annotated[int | None, Meta(description="sets with a missing pair")] = None
    held: Annotated[list[str] | None, Meta(description="who holds the projector")] = None


class Status(Struct, frozen=True, kw_only=True):
    """The whole daemon at one moment."""

    state: Annotated[str, Meta(description="starting, running, degraded, paused or stopping")]
    reasons: Annotated[list[str], Meta(description="why it is degraded")]
    warnings: Annotated[list[str], Meta(description="what measures, but not as well as it could")]
    device: Annotated[str, Meta(description="name of the rig")]
    session: Annotated[str, Meta(description="unique for each start of the daemon")]
    version: Annotated[str, Meta(description="of the program")]
    pid: Annotated[int, Meta(description="process id")]
    t_ns: Annotated[int, Meta(description="CLOCK_REALTIME")]
    uptime_s: Annotated[float, Meta(description="since the start, s")]
    calibration: Annotated[str, Meta(description="identity: sha256: and the digest of the file")]
    pairs: Annotated[int, Meta(description="pairs since the start")]
    clouds: Annotated[int, Meta(description="clouds since the start")]
    pair_rate_hz: Annotated[float, Meta(description="pairs per second")]
    cloud_rate_hz: Annotated[float, Meta(description="clouds per second")]
    points: Annotated[int, Meta(description="points of the newest cloud")]
    valid: Annotated[float, Meta(description="share of its pixels with a point, 0 to 1")]
    measured_every: Annotated[int, Meta(description="spacing of the measured pixels; 2 under load")]
    latency_ms: Annotated[dict[str, float], Meta(description="start of exposure to finished cloud: p50, p95, ...")]
    publish_latency_ms: Annotated[dict[str, float], Meta(description="arrival of both frames to the stream")]
    stages_ms: Annotated[dict[str, float], Meta(description="time by stage of the pipeline, newest cloud")]
    garbage: Annotated[dict[str, float], Meta(description="runs of the garbage collector, and their time")]
    processors: Annotated[dict[str, float], Meta(description="share of processor time that the daemon got")]
    calibration_check: Annotated[CalibrationCheck, Meta(description="check of every pair")]
    drops: Annotated[Counts, Meta(description="everything dropped, by reason")]
    drops_starting: Annotated[Counts, Meta(description="the part of drops before the daemon measured")]
    cameras: Annotated[dict[str, Camera], Meta(description="left and right")]
    sinks: Annotated[dict[str, dict[str, Any]], Meta(description="stream, remote and other sinks, each with counters")]
    recorder: Annotated[Recorder, Meta(description="the take that is written")]
    selfcheck: Annotated[DriftSummary, Meta(description="calibration drift")]
    health: Annotated[HealthSummary, Meta(description="verdict of the health monitor")]
    mode: Annotated[str, Meta(description="single, or the name of a multi-frame mode")]
    sequence: Annotated[Mode, Meta(description="images and sets of the mode")]
    kernels: Annotated[Counts, Meta(description="jobs of the compilation: ready and total")]
    memory: Annotated[dict[str, float], Meta(description="page faults in all, and while one pair is measured")] = {}
    slowest: Annotated[dict[str, Any], Meta(description="times of the slowest pair of the last minutes")] = {}
