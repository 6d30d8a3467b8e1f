"""Install and uninstall, step by step; each step can be done again."""

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
from daemon.apps.install.layout import CACHE, COMMAND, CONFIG, FILES, KERNELS, LOGS, PREFIX, RIG, STATE, UNITS, Place
from daemon.apps.install.target import MARK, Target, check_prefix
from daemon.common.files import write_atomically

Say = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is to be done besides putting files in place.

    Args:
        rig: the rig.yaml to begin with; None = a simulated rig.
        start: begin to measure now, and with the machine; view: the viewer too.
        compile: the kernels ahead.
    """

    rig: Path | None = None
    start: bool = True
    view: bool = False
    compile: bool = True


def install(target: Target, source: environment.Source, wishes: Wishes, say: Say) -> None:
    """Everything; nothing is touched when something is wrong with what was asked for.

    Raises:
        InstallError: what cannot be done; ConfigError: rig.yaml has mistakes.
    """
    _check_rights(target)
    check_prefix(target)
    source.check(target)
    config = config_files.gather(wishes.rig)
    _prepare(target)
    if environment.make(target, source):
        say(f"{target.prefix}/env: the environment")
        _remove(target.path(KERNELS))  # compiled from other files
    for path in files.put_all(target):
        say(str(path))
    for text in config_files.put(target, config):
        say(text)
    _compile(target, source, wishes, say)
    systemctl.take_notice(target)
    if wishes.start:
        projector = _needs_x(target)
        systemctl.enable(target, projector=projector, view=wishes.view)
        systemctl.start(target, projector=projector, view=wishes.view)
    environment.remove_old(target)
    say(_next_step(target, wishes))


def uninstall(target: Target, say: Say, *, purge: bool = False) -> None:
    """Take away what :func:`install` brought; data and configuration stay unless ``purge``."""
    _check_rights(target)
    check_prefix(target)
    if not target.path(PREFIX / MARK).is_file():
        raise InstallError(f"nothing is installed in {target.prefix}; name the prefix with --prefix")
    systemctl.stop(target)
    for place in FILES.values():
        target.path(place.path).unlink(missing_ok=True)
    command = target.path(COMMAND)
    if command.is_symlink() and command.readlink() == target.prefix / "bin/fringed":
        command.unlink()
    drop_ins = [FILES[unit].path.with_name(f"{unit}.d") for unit in UNITS]
    for directory in (CACHE, CACHE.with_name("fringed-view"), *((CONFIG, STATE, LOGS, *drop_ins) if purge else ())):
        _remove(target.path(directory))
    _remove(target.path(PREFIX))
    systemctl.take_notice(target)
    for text in systemctl.remove_users(target) if purge else ():
        say(text)
    kept = "" if purge else f"; {CONFIG}, {STATE} and {LOGS} stay (--purge takes them too)"
    say(f"fringed is taken away from {target.prefix}{kept}")


def _check_rights(target: Target) -> None:
    if not target.root.is_dir():
        raise InstallError(f"--root {target.root} is no directory; make it first")
    if target.live and os.geteuid() != 0:
        raise InstallError("only root can do this; put sudo before the command, or give --root DIR for an image")


def _prepare(target: Target) -> None:
    """Users, directories, and the mark that makes the prefix ours before it fills."""
    if os.geteuid() == 0:
        files.put_users_file(target)
        systemctl.make_users(target)
    target.path(PREFIX).mkdir(parents=True, exist_ok=True)
    mark = {"program": "fringed", "prefix": str(target.prefix)}
    write_atomically(target.path(PREFIX / MARK), json.dumps(mark).encode())
    target.set_rights(Place(PREFIX / MARK, 0o644))
    files.make_directories(target)


def _compile(target: Target, source: environment.Source, wishes: Wishes, say: Say) -> None:
    if source.shared:
        kernels.seed(target)
    if not wishes.compile:
        return
    if not target.live:
        say("the kernels are compiled when the service starts for the first time")
        return
    say("compiling the kernels, which takes minutes the first time")
    mode = _rig(target).get("mode", "single")
    kernels.compile_ahead(target, [mode] if isinstance(mode, str) and mode != "single" else [])


def _rig(target: Target) -> dict[str, Any]:
    from daemon.config.yaml_source import read_yaml

    data = read_yaml(target.path(RIG).read_text(encoding="utf-8")).data
    return data if isinstance(data, dict) else {}


def _needs_x(target: Target) -> bool:
    projector = _rig(target).get("projector")
    return isinstance(projector, dict) and projector.get("driver") == "x11"


def _next_step(target: Target, wishes: Wishes) -> str:
    if not target.live:
        return f"installed into the image {target.root}"
    if not wishes.start:
        return "installed; start it with: systemctl enable --now fringed"
    if not target.systemd:
        return "installed; no systemd runs here, the service starts with the next boot"
    return f"installed and started; see: systemctl status fringed, fringed status; the rig is {RIG}"


def _remove(path: Path) -> None:
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)
