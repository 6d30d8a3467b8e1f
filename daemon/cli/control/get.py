"""``fringed get``: the settings of a running daemon."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from daemon.cli.control.daemon_call import Endpoint, RigFile, Timeout, call_daemon
from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys


def main(
    path: Annotated[str, typer.Argument(help="A setting or a section, pairing.tolerance_us; all without it.")] = "",
    endpoint: Endpoint = None,
    rig: RigFile = None,
    live: Annotated[bool, typer.Option("--live", help="Only those that can be set while it measures.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows, or the one value, as JSON.")] = False,
    timeout: Timeout = 5.0,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Show the settings of a running daemon: value, unit, bounds, meaning, and which can be set live."""
    rows = call_daemon("get", endpoint, rig, timeout, chosen_keys(key, server_key), path=path, detail=True)["settings"]
    one = rows[0] if len(rows) == 1 and rows[0]["path"] == path else None
    rows = [row for row in rows if row["live"] or not live]
    if as_json:
        typer.echo(json.dumps(rows if one is None else one["value"], indent=2))
    elif one is not None:
        typer.echo(detail_text(one))
    else:
        typer.echo(list_text(rows))


def detail_text(row: dict[str, Any]) -> str:
    """Format one setting in a few lines."""
    when = {"live": "can be set live", "live by a reload": "is applied by a reload"}.get(_when(row), _when(row))
    lines = [f"{row['path']} = {value_text(row['value'])} {row.get('unit', '')}".rstrip(), f"  {row['doc']}"]
    lines.append(f"  {row['type']}{f', {bounds(row)}' if bounds(row) else ''}; {when}")
    if "default" in row and row["default"] != row["value"]:
        lines.append(f"  default: {value_text(row['default'])}")
    return "\n".join(lines)


def list_text(rows: list[dict[str, Any]]) -> str:
    """Format many settings, two lines each, with a gap between the sections of rig.yaml."""
    lines: list[str] = []
    section = rows[0]["path"].partition(".")[0] if rows else ""
    for row in rows:
        if row["path"].partition(".")[0] != section:
            section = row["path"].partition(".")[0]
            lines.append("")
        notes = [text for text in (bounds(row), _when(row)) if text]
        lines.append(
            f"{row['path']} = {value_text(row['value'])} {row.get('unit', '')}".rstrip() + f"  ({', '.join(notes)})"
        )
        lines.append(f"    {row['doc']}")
    return "\n".join(lines)


def _when(row: dict[str, Any]) -> str:
    if not row["live"]:
        return "needs a restart"
    return "live by a reload" if row.get("by_file") else "live"


def value_text(value: Any) -> str:
    """Format a value as in rig.yaml."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def bounds(row: dict[str, Any]) -> str:
    """Format the accepted values of a setting."""
    if "choices" in row:
        return " | ".join(str(choice) for choice in row["choices"])
    low = f"{row['min']:g}" if "min" in row else f"> {row['above']:g}" if "above" in row else ""
    high = f"{row['max']:g}" if "max" in row else f"< {row['below']:g}" if "below" in row else ""
    if low and high:
        return f"{low} to {high}" if "min" in row else f"{low}, up to {high}"
    if high:
        return f"at most {high}"
    return f"from {low}" if "min" in row else low
