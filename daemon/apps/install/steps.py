"""Installation and removal, step by step; each step is repeatable."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.apps.install import config_files, environment, files, kernels, systemctl
from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import (
    CACHE,
    COMMAND,
    CONFIG,
    FILES,
    KERNELS,
    LOGS,
    PREFIX,
    RIG,
    STATE,
    UNITS,
    InstalledPath,
)
from daemon.apps.install.target import MARK, Target, check_prefix
from daemon.common.files import write_atomically

Notify = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class InstallOptions:
    """Options of an installation.

    Args:
        rig: the initial rig.yaml; None = a simulated rig.
        start: start the service now and at boot; view: the viewer too.
        compile: compile the kernels ahead.
    """

    rig: Path | None = None
    start: bool = True
    view: bool = False
    compile: bool = True


def install(target: Target, source: environment.Source, options: InstallOptions, notify: Notify) -> None:
    """Install everything; invalid options are rejected before any change.

    Raises:
        InstallError: a failed step; ConfigError: rig.yaml has errors.
    """
    _check_permissions(target)
    check_prefix(target)
    source.check(target)
    config = config_files.collect_files(options.rig)
    _prepare(target)
    if environment.make(target, source):
        notify(f"{target.prefix}/env: the environment")
        _remove(target.path(KERNELS))  # compiled from the old files
    for path in files.write_all(target):
        notify(str(path))
    for text in config_files.write_files(target, config):
        notify(text)
    _compile(target, source, options, notify)
    systemctl.reload_managers(target)
    if options.start:
        projector = _needs_x(target)
        systemctl.enable(target, projector=projector, view=options.view)
        systemctl.start(target, projector=projector, view=options.view)
    environment.remove_old(target)
    notify(_next_step(target, options))


def uninstall(target: Target, notify: Notify, *, purge: bool = False) -> None:
    """Remove what :func:`install` installed; data and configuration are kept unless ``purge``."""
    _check_permissions(target)
    check_prefix(target)
    if not target.path(PREFIX / MARK).is_file():
        raise InstallError(f"nothing is installed in {target.prefix}; give the prefix with --prefix")
    systemctl.stop(target)
    for file in FILES.values():
        target.path(file.path).unlink(missing_ok=True)
    command = target.path(COMMAND)
    if command.is_symlink() and command.readlink() == target.prefix / "bin/fringed":
        command.unlink()
    drop_ins = [FILES[unit].path.with_name(f"{unit}.d") for unit in UNITS]
    for directory in (CACHE, CACHE.with_name("fringed-view"), *((CONFIG, STATE, LOGS, *drop_ins) if purge else ())):
        _remove(target.path(directory))
    _remove(target.path(PREFIX))
    systemctl.reload_managers(target)
    for text in systemctl.remove_users(target) if purge else ():
        notify(text)
    kept = "" if purge else f"; {CONFIG}, {STATE} and {LOGS} are kept (--purge removes them)"
    notify(f"fringed is removed from {target.prefix}{kept}")


def _check_permissions(target: Target) -> None:
    if not target.root.is_dir():
        raise InstallError(f"--root {target.root} is no directory; create it first")
    if target.live and os.geteuid() != 0:
        raise InstallError("the installation requires root; use sudo, or give --root DIR for an image")


def _prepare(target: Target) -> None:
    """Create users, directories, and the mark that reserves the prefix."""
    if os.geteuid() == 0:
        files.write_users_file(target)
        systemctl.make_users(target)
    target.path(PREFIX).mkdir(parents=True, exist_ok=True)
    mark = {"program": "fringed", "prefix": str(target.prefix)}
    write_atomically(target.path(PREFIX / MARK), json.dumps(mark).encode())
    target.set_permissions(InstalledPath(PREFIX / MARK, 0o644))
    files.make_directories(target)


def _compile(target: Target, source: environment.Source, options: InstallOptions, notify: Notify) -> None:
    if source.shared:
        kernels.copy_compiled(target)
    if not options.compile:
        return
    if not target.live:
        notify("the kernels are compiled when the service starts for the first time")
        return
    notify("compiling the kernels, which takes minutes the first time")
    mode = _rig(target).get("mode", "single")
    kernels.compile_ahead(target, [mode] if isinstance(mode, str) and mode != "single" else [])


def _rig(target: Target) -> dict[str, Any]:
    from daemon.config.yaml_source import read_yaml

    data = read_yaml(target.path(RIG).read_text(encoding="utf-8")).data
    return data if isinstance(data, dict) else {}


def _needs_x(target: Target) -> bool:
    projector = _rig(target).get("projector")
    return isinstance(projector, dict) and projector.get("driver") == "x11"


def _next_step(target: Target, options: InstallOptions) -> str:
    if not target.live:
        return f"installed into the image {target.root}"
    if not options.start:
        return "installed; start it with: systemctl enable --now fringed"
    if not target.systemd:
        return "installed; systemd does not run here, the service starts at the next boot"
    return f"installed and started; see: systemctl status fringed, fringed status; the rig is {RIG}"


def _remove(path: Path) -> None:
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)
