"""Write a setting into rig.yaml; comments and layout stay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from daemon.cli.control.daemon_call import call_daemon
from daemon.common.errors import InputError


def rig_file(rig: Path | None, endpoint: str | None) -> Path:
    """The given rig.yaml, or that of the running daemon.

    Raises:
        InputError: the daemon was not started from a file of this machine.
    """
    if rig is not None:
        return rig
    path = call_daemon("hello", endpoint, None, 5.0).get("rig")
    if path is None or not Path(path).is_file():
        raise InputError("the daemon was not started from a rig.yaml of this machine; name the file by --rig FILE")
    return Path(path)


def save_setting(path: Path, setting: str, value: Any) -> None:
    """Write one value; nothing is written if the file would not be valid, or its layout is not supported.

    Raises:
        ConfigError, DaemonError: with what to do.
    """
    from daemon.common.files import write_atomically
    from daemon.config.load import parse_rig
    from daemon.config.yaml_edit import with_value

    text = with_value(path.read_text(encoding="utf-8"), tuple(setting.split(".")), value, create=True)
    parse_rig(text, name=str(path), base_dir=path.parent)
    write_atomically(path, text.encode())
    typer.echo(f"written to {path}")
