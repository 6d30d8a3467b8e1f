"""Checks of rig.yaml beyond its schema: addresses, names of drivers and settings, files that must exist."""

from __future__ import annotations

import difflib
import ipaddress
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from daemon.config.driver_table import CAMERAS, PROJECTORS, RIGS
from daemon.config.sections.security import key_problems
from daemon.config.simulation import simulation_problems
from daemon.config.yaml_source import KeyPath
from pipeline.common.errors import PipelineError
from pipeline.common.settings import Settings
from pipeline.pattern.color_fringe import from_mapping as pattern_from_mapping
from pipeline.rig.pose import Pose

Problems = Iterator[tuple[KeyPath, str]]

UNCALIBRATED = "is missing; only the simulated rig has its own"
"""End of the message for each of calibration, pattern and volume that a rig lacks."""


def semantic_problems(data: dict[str, Any], base_dir: Path, *, complete: bool = True) -> Problems:
    """Yield every semantic mistake with the path of its value; values of a wrong type are left to the schema.

    Args:
        complete: whether calibration, pattern and volume are required; a rig before its calibration has none.
    """
    yield from _drivers(data)
    yield from _missing(data) if complete else ()
    yield from _settings(data)
    yield from _outputs(data, base_dir)
    yield from _cpus(data)
    yield from _addresses(data)
    yield from key_problems(data, base_dir)
    yield from _files(data, base_dir) if complete else ()
    yield from _volume(data)
    yield from _recording(data)
    yield from _mode(data)
    yield from simulation_problems(data, base_dir)


def _section(data: dict[str, Any], name: str) -> dict[str, Any]:
    value = data.get(name)
    return value if isinstance(value, dict) else {}


def _drivers(data: dict[str, Any]) -> Problems:
    known = {"cameras": [*RIGS, *CAMERAS], "projector": [*RIGS, *PROJECTORS]}
    for name, drivers in known.items():
        driver = _section(data, name).get("driver")
        if isinstance(driver, str) and driver not in drivers:
            near = difflib.get_close_matches(driver, drivers, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are: {', '.join(drivers)}"
            yield (name, "driver"), f"there is no driver {driver!r}; {hint}"
    cameras, projector = (_section(data, name).get("driver") for name in known)
    if cameras in CAMERAS and projector not in PROJECTORS:
        missing = f"projector.driver is {projector!r}" if projector in RIGS else "projector is missing"
        if projector is None or projector in RIGS:
            yield (), f"{missing}; the cameras {cameras!r} need one of: {', '.join(PROJECTORS)}"


def _missing(data: dict[str, Any]) -> Problems:
    cameras = _section(data, "cameras").get("driver")
    if cameras != "sim" and (cameras in RIGS or cameras in CAMERAS):
        for name in ("calibration", "pattern", "volume"):
            if data.get(name) is None:
                yield (), f"{name} {UNCALIBRATED}"


def _settings(data: dict[str, Any]) -> Problems:
    settings, right = _section(data, "pipeline").get("settings"), {}
    for key, value in settings.items() if isinstance(settings, dict) else ():
        if not isinstance(value, bool | int | float):
            continue
        try:
            Settings().with_overrides({key: value})
        except PipelineError as error:
            yield ("pipeline", "settings", key), str(error)
        else:
            right[key] = value
    try:  # together: a region's limits, for example
        Settings().with_overrides(right)
    except PipelineError as error:
        yield ("pipeline", "settings"), str(error)


def _outputs(data: dict[str, Any], base_dir: Path) -> Problems:
    frame = _section(data, "outputs").get("frame")
    if isinstance(frame, str) and not (base_dir / Path(frame).expanduser()).is_file():
        yield ("outputs", "frame"), f"outputs.frame: there is no file {base_dir / Path(frame).expanduser()}"
    if isinstance(frame, list):
        try:
            Pose.of_matrix(frame, "output", name="outputs.frame")
        except PipelineError as error:
            yield ("outputs", "frame"), str(error)


def _cpus(data: dict[str, Any]) -> Problems:
    value = _section(data, "pipeline").get("cpus")
    cpus: list[Any] = value if isinstance(value, list) else []
    for i, cpu in enumerate(cpus):
        if cpu in cpus[:i]:
            yield ("pipeline", "cpus", i), f"processor {cpu} is listed twice"


def _addresses(data: dict[str, Any]) -> Problems:
    stream, control = _section(data, "stream"), _section(data, "control")
    keys = isinstance(_section(data, "security").get("keys"), str)
    missing = _missing_for_others("stream", stream, keys=keys)
    for i, endpoint in _texts(stream.get("endpoints")):
        if problem := endpoint_problem(endpoint, missing=missing):
            yield ("stream", "endpoints", i), problem
    missing = _missing_for_others("control", control, keys=keys)
    for i, endpoint in _texts(control.get("remote")):
        if problem := remote_problem(endpoint, missing=missing):
            yield ("control", "remote", i), problem
    for _, endpoint in _texts([control.get("endpoint")]):
        if problem := endpoint_problem(endpoint, missing="write it under control.remote"):
            yield ("control", "endpoint"), problem


def _texts(values: Any) -> Iterator[tuple[int, str]]:
    for i, value in enumerate(values if isinstance(values, list) else ()):
        if isinstance(value, str):
            yield i, value


def _missing_for_others(service: str, section: dict[str, Any], *, keys: bool) -> str:
    """Return the settings that the file lacks before other machines may connect, "" when none."""
    allowed = section.get("allow_remote") is True
    missing = ([] if allowed else [f"{service}.allow_remote: true"]) + ([] if keys else ["security.keys"])
    return f"set {' and '.join(missing)}" if missing else ""


def endpoint_problem(endpoint: str, *, missing: str) -> str | None:
    """Return the problem of a ZeroMQ address, or None; ``missing``: settings it needs if other machines reach it."""
    if endpoint.startswith("ipc://"):
        length = len(endpoint.removeprefix("ipc://").encode())
        if not 0 < length <= 107:
            return f"{endpoint!r}: a socket path has 1 to 107 bytes, this one {length}"
        return None
    host = _tcp_host(endpoint)
    if host is None:
        return f"{endpoint!r} is not an address; write ipc:///path or tcp://127.0.0.1:5555"
    if missing and not is_local(host):
        return f"{endpoint!r} can be reached by other machines; use 127.0.0.1 and a tunnel, or {missing}"
    return None


def remote_problem(endpoint: str, *, missing: str) -> str | None:
    """Return the problem of an address for other machines, or None."""
    if _tcp_host(endpoint) is None:
        return f"{endpoint!r} is not an address for other machines; write tcp://0.0.0.0:5556"
    return f"{endpoint!r} is for other machines: {missing}" if missing else None


def for_others(endpoint: str) -> bool:
    """Return whether other machines can reach an address."""
    host = _tcp_host(endpoint)
    return host is not None and not is_local(host)


def _tcp_host(endpoint: str) -> str | None:
    """Return the host of ``tcp://HOST:PORT``, port ``*`` for any free one; None for another form."""
    text = f"{endpoint[:-1]}0" if endpoint.startswith("tcp://") and endpoint.endswith(":*") else endpoint
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    whole = parts.scheme == "tcp" and port is not None and not (parts.path or parts.query or parts.fragment)
    return host if whole and "@" not in text else None


def is_local(host: str) -> bool:
    """Return whether a host is this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _files(data: dict[str, Any], base_dir: Path) -> Problems:
    for name in ("calibration", "pattern", "volume"):
        value = data.get(name)
        if isinstance(value, str) and not (base_dir / Path(value).expanduser()).is_file():
            yield (name,), f"{name}: there is no file {base_dir / Path(value).expanduser()}"
    if isinstance(data.get("pattern"), dict):
        try:
            pattern_from_mapping(data["pattern"])
        except PipelineError as error:
            yield ("pattern",), str(error)


def _volume(data: dict[str, Any]) -> Problems:
    volume = _section(data, "volume")
    near, far = volume.get("near_mm"), volume.get("far_mm")
    if isinstance(near, int | float) and isinstance(far, int | float) and near >= far:
        yield ("volume", "far_mm"), f"volume.far_mm {far} must be larger than near_mm {near}"


def _recording(data: dict[str, Any]) -> Problems:
    recording = _section(data, "recording")
    for key in ("keep_mb", "keep_s"):
        value = recording.get(key)
        if isinstance(value, int | float) and value > 0 and recording.get("endless") is not True:
            yield ("recording", key), f"recording.{key} removes old parts, which needs recording.endless: true"


def _mode(data: dict[str, Any]) -> Problems:
    """Check that the projector of a multi-frame mode can show more than one image."""
    mode, projector = data.get("mode", "single"), _section(data, "projector").get("driver")
    if mode == "single" or not isinstance(mode, str):
        return
    stored = _section(data, "sequence").get("display") == "stored"
    if _section(data, "cameras").get("driver") == "sim":
        if _section(data, "simulation").get("live") is False:
            yield (
                ("simulation", "live"),
                f"simulation.live is false: a rendered loop has one image, mode {mode} several",
            )
    elif projector == "external" and not stored:
        yield (
            ("mode",),
            (
                f"mode {mode}: projector.driver external does not show images on request; store them in it and set "
                "sequence.display: stored, or use projector.driver: x11"
            ),
        )
    elif projector == "x11" and stored:
        yield ("sequence", "display"), "sequence.display: projector.driver x11 stores no images; set driven"
