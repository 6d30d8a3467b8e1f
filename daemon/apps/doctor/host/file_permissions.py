"""Permissions of the rig's files: other users must not read keys or change files."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.subject import Subject
from daemon.common.errors import DaemonError
from daemon.keys.key_store import KeyStore

area = Area("files")


def check(subject: Subject) -> Iterator[Finding]:
    """Check the rig file, the calibration, the takes and the keys."""
    config = subject.config
    if config is None:
        yield area.note("files", "no rig.yaml, so no files to check")
        return
    paths = {"rig file": subject.path, "takes": subject.base_dir / Path(config.recording.dir).expanduser()}
    if config.calibration is not None:
        paths["calibration"] = subject.base_dir / Path(config.calibration).expanduser()
    for name, path in paths.items():
        if path is not None and path.exists():
            yield changeable(name, path)
    if config.security.keys is not None:
        yield keys(config.path(config.security.keys, subject.base_dir))


def changeable(name: str, path: Path) -> Finding:
    """Check a file or directory that only its owner and its group may change."""
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
        return area.warning(name, f"{path} can be changed by every user (mode {mode:04o})", f"chmod o-w {path}")
    return area.ok(name, f"{path} cannot be changed by other users (mode {mode:04o})")


def keys(directory: Path) -> Finding:
    """Check the keys for other machines."""
    store = KeyStore(directory)
    if not store.readable():
        return area.note("keys", f"{directory} is readable only by the service's user")
    try:
        store.server()
        authorized = store.authorized()
    except DaemonError as error:
        return area.problem(
            "keys", str(error), f"fringed keys server --dir {directory}; fringed keys list --dir {directory}"
        )
    return area.ok("keys", f"{directory}: {len(authorized.entries)} keys may connect from other machines")
