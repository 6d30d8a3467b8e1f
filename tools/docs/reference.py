"""Generated parts of the reference: commands and settings, from the code that defines them.

A page contains ``<!-- generated: NAME -->``, which the build replaces by the text of the function in ``PARTS``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

MARK = re.compile(r"<!-- generated: (\w+) -->")


def with_parts(markdown: str) -> str:
    """The page with every mark replaced; a KeyError names an unknown part."""
    return MARK.sub(lambda found: PARTS[found[1]](), markdown)


def commands() -> str:
    """Every command with its arguments and options."""
    from daemon.cli.command_table import COMMANDS, load

    parts = []
    for name, (target, summary) in COMMANDS.items():
        parts += [f"## fringed {name}", "", *_command(f"fringed {name}", load(name, target, summary), summary)]
    return "\n".join(parts)


def _command(path: str, command: Any, summary: str) -> Iterator[str]:
    yield _plain(command.help or summary)
    yield ""
    inner = getattr(command, "commands", None) or {}
    if rows := list(_parameters(command)):
        yield from ("| argument, option | meaning | default |", "| --- | --- | --- |", *rows, "")
    for name, child in inner.items():
        if not child.hidden:
            yield from (f"### {path} {name}", "", *_command(f"{path} {name}", child, ""))


def _parameters(command: Any) -> Iterator[str]:
    for parameter in command.params:
        if parameter.hidden or parameter.name == "help":
            continue
        if parameter.param_type_name == "argument":
            name = parameter.name.upper() if parameter.required else f"[{parameter.name.upper()}]"
        else:
            kind = parameter.metavar or _kind(parameter.type_descriptor.annotation)
            name = ", ".join(parameter.opts + parameter.secondary_opts) + ("" if parameter.is_flag else f" {kind}")
        default = parameter.default
        shown = "" if callable(default) or default in (None, "", False, (), []) else f"`{default}`"
        yield f"| `{_cell(name)}` | {_cell(_plain(parameter.help or ''))} | {_cell(shown)} |"


def _kind(annotation: Any) -> str:
    choices = getattr(annotation, "__members__", None)
    return "|".join(choices) if choices else getattr(annotation, "__name__", str(annotation)).upper()


def settings() -> str:
    """Every setting of rig.yaml with type, bounds, unit, default and meaning."""
    from daemon.cli.control.get import bounds, value_text
    from daemon.config.load import parse_rig
    from daemon.control.settings.catalogue import catalogue
    from pipeline.common.settings import Settings

    rows = catalogue(parse_rig("cameras: {driver: sim}\n"), Settings())
    sections: dict[str, list[str]] = {}
    for row in rows:
        default = value_text(row.get("default", row["value"]))
        values = f"{row['type']} {bounds(row)}".strip() + (f", {row['unit']}" if "unit" in row else "")
        live = "" if not row["live"] else "reload" if row.get("by_file") else "yes"
        cells = (f"`{row['path']}`", f"`{default}`", values, live, _plain(row["doc"]))
        section = row["path"].rpartition(".")[0] or "rig"
        sections.setdefault(section, []).append(f"| {' | '.join(map(_cell, cells))} |")
    head = ["| setting | default | values | live | meaning |", "| --- | --- | --- | --- | --- |"]
    return "\n".join("\n".join([f"## {name}", "", *head, *lines, ""]) for name, lines in sections.items())


def _plain(text: str) -> str:
    return " ".join(text.replace("``", "`").split())


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


PARTS: dict[str, Callable[[], str]] = {"commands": commands, "settings": settings}
