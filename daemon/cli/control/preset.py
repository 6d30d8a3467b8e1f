"""``fringed preset``: list, save and use presets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from daemon.cli.control.daemon_call import Endpoint, RigFile, Timeout, call_daemon
from daemon.cli.control.save_setting import rig_file, save_setting
from daemon.common.errors import InputError

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.callback()
def main() -> None:
    """Presets of the reconstruction: precise, balanced, fast, dynamic, and your own beside rig.yaml."""


@app.command("list")
def show(rig: RigFile = None) -> None:
    """List the presets with what they change; own ones are found beside rig.yaml."""
    from daemon.config.presets import MEANINGS, preset_names, read_preset

    folder = Path() if rig is None else rig.parent
    for name in preset_names(folder):
        values = read_preset(name, folder)
        flat = {k: v for k, v in values.items() if k != "settings"} | dict(values.get("settings", {}))
        changes = ", ".join(f"{key} {value}" for key, value in flat.items())
        typer.echo(f"{name}: {MEANINGS.get(name, 'own preset')}{f' ({changes})' if changes else ''}")


@app.command()
def save(
    name: Annotated[str, typer.Argument(help="Name of the new preset.")],
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 5.0,
    replace: Annotated[bool, typer.Option("--replace", help="Replace an own preset of this name.")] = False,
) -> None:
    """Save the present settings of a running daemon as a preset beside its rig.yaml."""
    import yaml

    from daemon.common.files import write_atomically
    from daemon.config.presets import KEYS, preset_path

    path = preset_path(name, rig_file(rig, endpoint).parent)
    if path.exists() and not replace:
        raise InputError(f"{path} exists; choose another name, or give --replace")
    rows = call_daemon("get", endpoint, rig, timeout, None, path="pipeline", detail=True)["settings"]
    values: dict[str, Any] = {"fringed_preset": 1}
    for row in rows:
        key = row["path"].removeprefix("pipeline.")
        if key.startswith("settings.") and row["value"] != row["default"]:
            values.setdefault("settings", {})[key.removeprefix("settings.")] = row["value"]
        elif key in KEYS and row["value"] != KEYS[key]:
            values[key] = row["value"]
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, yaml.safe_dump(values, sort_keys=False).encode())
    typer.echo(str(path))


@app.command()
def use(
    name: Annotated[str, typer.Argument(help="A preset, as `fringed preset list` lists them.")],
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = 30.0,
    save_: Annotated[bool, typer.Option("--save", help="Write it into rig.yaml, too.")] = False,
) -> None:
    """Change a running daemon to a preset; settings that were changed before return to it."""
    answer = call_daemon("set", endpoint, rig, timeout, None, path="preset", value=name)
    typer.echo(f"preset = {json.dumps(answer['preset'])}")
    if save_:
        save_setting(rig_file(rig, endpoint), "preset", answer["preset"])
