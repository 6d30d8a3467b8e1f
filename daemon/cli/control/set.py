"""``fringed set``: change a setting of a running daemon."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any

import typer

from daemon.cli.control.daemon_call import SLOW_S, Endpoint, RigFile, Timeout, call_daemon
from daemon.cli.control.save_setting import rig_file, save_setting
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys
from daemon.common.errors import InputError

app = typer.Typer(add_completion=False)


# A negative number is a value, not an option.
@app.command(context_settings={"ignore_unknown_options": True})
def main(
    path: Annotated[str, typer.Argument(help="The setting, as `fringed get` lists it.")],
    value: Annotated[str, typer.Argument(help="A number, true, false or text; JSON for more than that.")],
    endpoint: Endpoint = None,
    rig: RigFile = None,
    timeout: Timeout = SLOW_S,
    save: Annotated[bool, typer.Option("--save", help="Write it into rig.yaml, too; comments stay.")] = False,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Change a setting while the daemon measures; without --save a reload restores the value of rig.yaml."""
    answer = call_daemon("set", endpoint, rig, timeout, chosen_keys(key, server_key), path=path, value=parsed(value))
    target = rig_file(rig, endpoint) if save else None
    for name, now in answer.items():
        if name != path:
            typer.echo(f"fringed: {path} is called {name} now; the former name ends with the next release", err=True)
        typer.echo(f"{name} = {json.dumps(now, ensure_ascii=False)}")
        if target is not None:
            save_setting(target, name, now)


def parsed(text: str) -> Any:
    """Parse a value as JSON; anything else is text.

    Raises:
        InputError: infinite, or not a number; no setting takes it.
    """
    try:
        value = json.loads(text)
    except ValueError:
        value = _number(text)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{text} is not a finite number; `fringed get PATH` shows what a setting takes")
    return value


def _number(text: str) -> Any:
    """``nan`` and ``inf`` in all spellings as numbers; the text otherwise."""
    try:
        value = float(text)
    except ValueError:
        return text
    return text if math.isfinite(value) else value
