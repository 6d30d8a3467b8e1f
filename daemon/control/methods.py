"""What can be asked of a running daemon."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daemon.atomic import write_atomically
from daemon.config import load_rig
from daemon.config.models import RigConfig
from daemon.control.calibrate import CalibrateMethods
from daemon.control.protocol import FAILED, INVALID_PARAMS, Method, RpcError
from daemon.errors import ConfigError, DaemonError
from daemon.recorder import Recorder
from daemon.service import Service, program_version
from drivers.errors import DriverError
from pipeline.errors import PipelineError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_LIVE = "pipeline.settings"
_PLAIN = {
    "white": (255, 255, 255),
    "black": (0, 0, 0),
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
}


class Methods:
    """The table of methods for one service.

    Args:
        service: the daemon; recorder: its recording switch; path: its rig.yaml, for ``reload``.
        base_dir: where its relative paths start; calibrate: the methods ``calibrate.*``, if it offers them.
    """

    def __init__(
        self,
        service: Service,
        recorder: Recorder,
        *,
        path: Path | None,
        base_dir: Path,
        calibrate: CalibrateMethods | None = None,
    ) -> None:
        self._service, self._recorder, self._path, self._base_dir = service, recorder, path, base_dir
        self._calibrate = calibrate

    def table(self) -> Mapping[str, Method]:
        """Every method by its name, with the parameters that it takes."""
        own: dict[str, tuple[Callable[[dict[str, Any]], Any], tuple[str, ...]]] = {
            "hello": (self.hello, ()),
            "status": (self.status, ()),
            "start": (lambda _: self._measure(True), ()),
            "stop": (lambda _: self._measure(False), ()),
            "get": (self.get, ("path",)),
            "set": (self.set, ("path", "value")),
            "reload": (self.reload, ()),
            "snapshot": (self.snapshot, ("name",)),
            "record.start": (self.record_start, ("name",)),
            "record.stop": (lambda _: self._recorder.stop(), ()),
            "pattern.show": (self.pattern_show, ("name",)),
            "pattern.mode": (self.pattern_mode, ("name",)),
        }
        if self._calibrate is not None:
            own |= self._calibrate.table()
        return {name: _checked(method, allowed) for name, (method, allowed) in own.items()}

    def hello(self, _: dict[str, Any]) -> dict[str, Any]:
        """Who answers."""
        service = self._service
        return {
            "program": "fringed",
            "version": program_version(),
            "protocol": 1,
            "device": service.config.device.name,
            "session": service.session,
            "stream": list(service.config.stream.endpoints),
            "methods": sorted(self.table()),
        }

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """See :class:`daemon.status.Status`."""
        return self._service.status().as_dict()

    def get(self, params: dict[str, Any]) -> Any:
        """The configuration as it is now, or the part at ``path`` (``pipeline.settings.min_modulation``)."""
        path = _text(params, "path", "")
        value: Any = current(self._service)
        for part in path.split(".") if path else ():
            if not isinstance(value, dict) or part not in value:
                raise RpcError(INVALID_PARAMS, f"there is no setting {path!r:.100}", path)
            value = value[part]
        return value

    def set(self, params: dict[str, Any]) -> Any:
        """Change a setting that can change while measuring."""
        path = _text(params, "path")
        section, _, key = path.rpartition(".")
        if section != _LIVE or "value" not in params:
            raise RpcError(INVALID_PARAMS, f"{path!r:.100} cannot be set live; only {_LIVE}.* can, with a value", path)
        try:
            settings = self._service.settings.with_overrides({key: params["value"]})
        except PipelineError as error:
            raise RpcError(INVALID_PARAMS, str(error), path) from error
        self._service.apply(settings)
        return {path: getattr(settings, key)}

    def reload(self, _: dict[str, Any]) -> dict[str, Any]:
        """Read rig.yaml again; take over what can change live, or refuse all of it."""
        if self._path is None:
            raise RpcError(FAILED, "this daemon was not started from a file")
        try:
            fresh = load_rig(self._path)
        except (ConfigError, OSError) as error:
            raise RpcError(FAILED, str(error)) from error
        old, new = _without_settings(self._service.config), _without_settings(fresh)
        restart = sorted(name for name in new if new[name] != old[name])
        if restart:
            raise RpcError(FAILED, f"nothing was changed: {', '.join(restart)} need a restart", restart[0])
        before = self._service.settings
        settings = type(before)().with_overrides(fresh.pipeline.settings)
        if settings != before:
            self._service.apply(settings)
        return {"changed": settings != before}

    def snapshot(self, params: dict[str, Any]) -> dict[str, Any]:
        """Write the newest cloud into the recording directory."""
        name = _name(params, "snapshot")
        item = self._service.worker.last
        if item is None:
            raise RpcError(FAILED, "there is no cloud yet")
        directory = self._service.config.path(self._service.config.recording.dir, self._base_dir)
        directory.mkdir(parents=True, exist_ok=True)
        target = directory / f"{name}_{item.seq:06d}.npz"
        buffer = io.BytesIO()
        np.savez(buffer, xyz=item.cloud.xyz, sigma_mm=item.cloud.sigma_mm, gray=item.cloud.gray)
        write_atomically(target, buffer.getvalue())
        return {"file": str(target), "seq": item.seq, "t_ns": item.t_ns, "points": item.cloud.points}

    def record_start(self, params: dict[str, Any]) -> dict[str, Any]:
        """Begin a take."""
        try:
            return self._recorder.start(_name(params, "take"))
        except (DaemonError, OSError) as error:
            raise RpcError(FAILED, str(error)) from error

    def pattern_show(self, params: dict[str, Any]) -> dict[str, Any]:
        """Show the measuring ``fringe`` or a plain picture; no cloud can be expected under a plain one."""
        name = _text(params, "name", "fringe")
        if self._calibrate is not None:
            self._calibrate.refuse_while_capturing()
        size, sequencing = self._service.rig.pattern.size, self._service.sequencing
        if name == "fringe":
            sequencing.show_measuring()
        elif name in _PLAIN:
            sequencing.show_plain(np.full((*size[::-1], 3), _PLAIN[name], np.uint8))
        else:
            raise RpcError(INVALID_PARAMS, f"there is no picture {name!r:.60}; there are fringe, {', '.join(_PLAIN)}")
        return {"shown": name}

    def pattern_mode(self, params: dict[str, Any]) -> dict[str, Any]:
        """Tell the mode, or measure in another one: ``single``, ``two_color``, ``heterodyne``, ``gray``."""
        from daemon.sequencing.change import change_mode

        if "name" in params:
            try:
                change_mode(self._service, _text(params, "name"))
            except PipelineError as error:
                raise RpcError(FAILED, str(error)) from error
        return self._service.sequencing.status()

    def _measure(self, wanted: bool) -> dict[str, Any]:
        self._service.measure(wanted)
        return {"state": str(self._service.state()[0])}


def current(service: Service) -> dict[str, Any]:
    """The configuration with the pipeline's settings as they are now, every default filled in."""
    from dataclasses import asdict

    values = service.config.model_dump(mode="json")
    values["pipeline"]["settings"] = asdict(service.settings)
    values["mode"] = service.sequencing.mode
    return values


def _without_settings(config: RigConfig) -> dict[str, Any]:
    values = config.model_dump(mode="json")
    del values["pipeline"]["settings"]
    return values


def _checked(method: Method, allowed: tuple[str, ...]) -> Method:
    def call(params: dict[str, Any]) -> Any:
        unknown = sorted(set(params) - set(allowed))
        if unknown:
            known = ", ".join(allowed) or "none"
            raise RpcError(INVALID_PARAMS, f"unknown parameter {unknown[0]!r:.60}; known: {known}")
        try:
            return method(params)
        except (DaemonError, DriverError) as error:
            raise RpcError(FAILED, str(error)) from error

    return call


def _text(params: dict[str, Any], key: str, default: str | None = None) -> str:
    value = params.get(key, default)
    if not isinstance(value, str):
        raise RpcError(INVALID_PARAMS, f"the parameter {key} must be a text")
    return value


def _name(params: dict[str, Any], default: str) -> str:
    """A name that is safe as part of a file name: no separators, no leading dot."""
    name = _text(params, "name", default)
    if not _NAME.fullmatch(name):
        raise RpcError(INVALID_PARAMS, "name takes letters, digits, '.', '_' and '-', at most 64, not '.' first")
    return name
