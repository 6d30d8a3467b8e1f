"""The RPC methods of a running daemon."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daemon.common.errors import DaemonError, InputError
from daemon.common.files import checked_name, write_atomically
from daemon.common.version import program_version
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.health_methods import HealthMethods
from daemon.control.rpc.params import number, string
from daemon.control.rpc.protocol import FAILED, INVALID_PARAMS, Method, Role, RpcError
from daemon.control.settings.catalogue import catalogue
from daemon.control.settings.change import Changer, NeedsRestartError, SettingError
from daemon.control.settings.flatten import current_path
from daemon.control.settings.reload import Reloader
from daemon.live.service import Service
from daemon.recording.recorder import Recorder
from pipeline.common.errors import PipelineError

log = logging.getLogger("fringed.control")

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
        service: the daemon; recorder: its recorder; path: its rig.yaml, for ``reload``.
        base_dir: base of its relative paths; calibrate: the methods ``calibrate.*``, if it offers them.
        health: the methods ``health*``, if its health is monitored.
    """

    def __init__(
        self,
        service: Service,
        recorder: Recorder,
        *,
        path: Path | None,
        base_dir: Path,
        calibrate: CalibrateMethods | None = None,
        health: HealthMethods | None = None,
    ) -> None:
        self._service, self._recorder, self._base_dir = service, recorder, base_dir
        self._calibrate, self._health, self._path = calibrate, health, path
        self._changer = Changer(service, base_dir)
        self._reloader = Reloader(self._changer, path, self._refusal)

    def table(self) -> Mapping[str, Method]:
        """Return every method by its name."""
        view = Role.VIEW
        own = {
            "hello": Method(self.hello, role=view),
            "status": Method(self.status, role=view),
            "get": Method(self.get, ("path", "detail"), role=view),
            "start": Method(lambda _: self._measure(True)),
            "stop": Method(lambda _: self._measure(False)),
            "set": Method(self.set, ("path", "value"), slow=True),
            "reload": Method(self.reload, slow=True),
            "snapshot": Method(self.snapshot, ("name",), slow=True),
            "record.start": Method(self.record_start, ("name", "before_s"), slow=True),
            "record.stop": Method(lambda _: self._recorder.stop(), slow=True),
            "takes.list": Method(lambda _: self._recorder.takes(), role=view, slow=True),
            "pattern.show": Method(self.pattern_show, ("name",), slow=True),
            "pattern.mode": Method(self.pattern_mode, ("name",), slow=True),
        }
        if self._calibrate is not None:
            own |= self._calibrate.table()
        if self._health is not None:
            own |= self._health.table()
        return own

    def hello(self, _: dict[str, Any]) -> dict[str, Any]:
        """Return version, device, session and methods of the daemon."""
        service = self._service
        return {
            "program": "fringed",
            "version": program_version(),
            "protocol": 1,
            "device": service.config.device.name,
            "session": service.session,
            "stream": _of_sink(service, "stream", "endpoints") or list(service.config.stream.endpoints),
            "remote": _of_sink(service, "remote", "stream") or [],
            "shared": bool(_of_sink(service, "stream", "shared")),
            "rig": None if self._path is None else str(self._path.absolute()),
            "methods": sorted(self.table()),
        }

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """Return the status, see :class:`daemon.live.status.Status`."""
        return self._service.status().as_dict()

    def get(self, params: dict[str, Any]) -> Any:
        """Return settings.

        Params: ``path`` of a setting or a section, for its value; without one, or with ``detail: true``: a row for
        each, see :func:`daemon.control.settings.catalogue.catalogue`.
        """
        path, detail = _current(string(params, "path", "")), params.get("detail", False)
        if not isinstance(detail, bool):
            raise RpcError(INVALID_PARAMS, "detail must be true or false")
        config, settings = self._service.config, self._service.settings
        rows = catalogue(config, settings, path)
        if not rows:
            raise RpcError(INVALID_PARAMS, f"there is no setting {path!r:.100}; get without a path lists them", path)
        if detail or not path:
            return {"settings": rows}
        return rows[0]["value"] if rows[0]["path"] == path else _nested(rows, path)

    def set(self, params: dict[str, Any]) -> Any:
        """Change a setting that can change while measuring; return its new value."""
        path = _current(string(params, "path"))
        if "value" not in params:
            raise RpcError(INVALID_PARAMS, "the parameter value is missing", path)
        if path == "mode" and (refusal := self._refusal()):
            raise RpcError(FAILED, f"the mode stays as it is: {refusal}", path)
        try:
            value = self._changer.set(path, params["value"])
        except SettingError as error:
            raise RpcError(INVALID_PARAMS, str(error), error.path) from error
        except (DaemonError, PipelineError, OSError) as error:
            raise RpcError(FAILED, str(error), path) from error
        log.info("set: %s = %s", path, value)
        return {path: value}

    def reload(self, _: dict[str, Any]) -> dict[str, Any]:
        """Read rig.yaml and its files again; apply all of it, or refuse all of it."""
        try:
            return self._reloader.reload()
        except NeedsRestartError as error:
            data = {"changed": [], "restart": error.restart, "live": error.live}
            raise RpcError(FAILED, str(error), error.restart[0], data=data) from error
        except (DaemonError, PipelineError, OSError) as error:
            raise RpcError(FAILED, str(error)) from error

    def _refusal(self) -> str:
        """Return why neither a reload nor a new mode is possible now."""
        if self._recorder.recording:
            return "a take is being written, which carries the calibration and the mode; stop it first"
        if self._calibrate is not None and self._calibrate.capturing:
            return "a capture for a calibration is in progress; end it with calibrate.cancel"
        return ""

    def snapshot(self, params: dict[str, Any]) -> dict[str, Any]:
        """Write the newest cloud into the recording directory."""
        name = _name(params, "snapshot")
        item = self._service.worker.last
        if item is None:
            raise RpcError(FAILED, "there is no cloud yet")
        directory = self._service.config.path(self._service.config.recording.dir, self._base_dir)
        directory.mkdir(parents=True, exist_ok=True)
        target = directory / f"{name}_{item.seq:06d}.npz"
        cloud = item.cloud
        optional = {"rgb": cloud.rgb, "normals": cloud.normals, "interpolated": cloud.interpolated}
        extra: dict[str, Any] = {name: array for name, array in optional.items() if array is not None}
        buffer = io.BytesIO()
        np.savez(buffer, xyz=cloud.xyz, sigma_mm=cloud.sigma_mm, gray=cloud.gray, **extra)
        write_atomically(target, buffer.getvalue())
        return {"file": str(target), "seq": item.seq, "t_ns": item.t_ns, "points": item.cloud.points}

    def record_start(self, params: dict[str, Any]) -> dict[str, Any]:
        """Begin a take, ``before_s`` seconds ago if they are in the buffer."""
        name, before_s = _name(params, "take"), number(params, "before_s", 0.0, 0, 3600)
        try:
            return self._recorder.start(name, before_s)
        except (DaemonError, OSError) as error:
            raise RpcError(FAILED, str(error)) from error

    def pattern_show(self, params: dict[str, Any]) -> dict[str, Any]:
        """Show the measuring ``fringe`` or a plain image, under which no cloud is measured."""
        name = string(params, "name", "fringe")
        if self._calibrate is not None:
            self._calibrate.refuse_while_capturing()
        size, mode_controller = self._service.rig.pattern.size, self._service.mode_controller
        if name == "fringe":
            mode_controller.show_measuring()
        elif name in _PLAIN:
            mode_controller.show_plain(np.full((*size[::-1], 3), _PLAIN[name], np.uint8))
        else:
            raise RpcError(INVALID_PARAMS, f"there is no image {name!r:.60}; there are fringe, {', '.join(_PLAIN)}")
        return {"shown": name}

    def pattern_mode(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the mode; with ``name``, set it first."""
        if "name" in params:
            self.set({"path": "mode", "value": string(params, "name")})
        return self._service.mode_controller.status()

    def _measure(self, on: bool) -> dict[str, Any]:
        self._service.measure(on)
        return {"state": str(self._service.state()[0])}


def _of_sink(service: Service, sink: str, key: str) -> Any:
    """Return a value of a sink's status, such as its addresses with their real ports; None without the sink."""
    made = service.router.sinks.get(sink)
    return None if made is None else made.status().get(key)


def _current(path: str) -> str:
    """The present path of a setting; a path of the last release is logged."""
    now = current_path(path)
    if now != path:
        log.warning("setting %s is called %s now; the former name ends with the next release", path, now)
    return now


def _nested(rows: list[dict[str, Any]], path: str) -> dict[str, Any]:
    """Return the section at ``path`` as nested values, as in rig.yaml."""
    out: dict[str, Any] = {}
    for row in rows:
        *above, name = row["path"].removeprefix(path + ".").split(".")
        inner = out
        for part in above:
            inner = inner.setdefault(part, {})
        inner[name] = row["value"]
    return out


def _name(params: dict[str, Any], default: str) -> str:
    """Return a name that is safe as part of a file name: no separators, no leading dot."""
    try:
        return checked_name(string(params, "name", default))
    except InputError as error:
        raise RpcError(INVALID_PARAMS, str(error)) from error
