"""Command lines of the documentation, checked against the real parser, the Makefile and the files of the project."""

from __future__ import annotations

import importlib.util
import re
import shlex
from typing import Any

from tools.docs.pages import ROOT

PROGRAMS = frozenset(
    {
        "Xorg", "cp", "dask", "export", "journalctl", "pip", "srun", "ssh", "sudo", "systemctl", "systemd-analyze",
        "tools/system-packages", "xhost", "xrandr",
    }
)  # fmt: skip
"""Programs of the system and of other packages that appear in the pages."""
_SEPARATOR = re.compile(r"[;&|]+")
_ASSIGNMENT = re.compile(r"^\w+=")


def check(text: str) -> list[str]:
    """The problems of a shell block, one sentence each."""
    joined = re.sub(r"\\\n\s*", " ", text)
    found = []
    for command in _commands(joined):
        problem = _problem(command)
        if problem:
            found.append(f"{shlex.join(command)}: {problem}")
    return found


def fringed_lines(text: str) -> list[list[str]]:
    """The arguments of every ``fringed`` command of a block."""
    lines = []
    for command in _commands(re.sub(r"\\\n\s*", " ", text)):
        place = _place_of_fringed(command)
        if place is not None:
            lines.append(command[place + 1 :])
    return lines


def _commands(text: str) -> list[list[str]]:
    """The simple commands of a text, each as its parts; comments are left out."""
    commands: list[list[str]] = []
    for line in text.split("\n"):
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|")
        lexer.whitespace_split = True
        commands.append([])
        for part in lexer:
            if _SEPARATOR.fullmatch(part):
                commands.append([])
            else:
                commands[-1].append(part)
    return [command for command in commands if command]


def _place_of_fringed(command: list[str]) -> int | None:
    return next(
        (i for i, part in enumerate(command) if part.rpartition("/")[2] == "fringed" and not _is_value(command, i)),
        None,
    )


def _is_value(command: list[str], place: int) -> bool:
    """Whether the part is an argument of another program, such as a unit of systemctl."""
    return any(part in ("systemctl", "journalctl", "systemd-analyze", "usermod") for part in command[:place])


def _problem(command: list[str]) -> str:
    parts = [part for part in command if not _ASSIGNMENT.match(part)] or command
    place = _place_of_fringed(parts)
    if place is not None:
        return parse(parts[place + 1 :])
    program, *arguments = parts
    if program == "make":
        return (
            "" if all(_is_target(part) for part in arguments if "=" not in part) else "no such target of the Makefile"
        )
    if program.rpartition("/")[2].startswith("python"):
        return _python(arguments)
    if program in ("for", "do", "done") or program in PROGRAMS or _ASSIGNMENT.match(program):
        return ""
    return f"{program} is not in tools.docs.command_lines.PROGRAMS"


def _is_target(name: str) -> bool:
    return re.search(rf"^{re.escape(name)}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE) is not None


def _python(arguments: list[str]) -> str:
    if arguments[:1] == ["-m"]:
        return "" if importlib.util.find_spec(arguments[1]) else f"there is no module {arguments[1]}"
    if arguments[:1] == ["-c"]:
        return ""
    return "" if arguments and (ROOT / arguments[0]).is_file() else f"there is no file {arguments[:1]}"


def parse(arguments: list[str]) -> str:
    """Why the command line cannot be parsed, by the program's own parser; empty if it can."""
    from daemon.cli.command_table import COMMANDS, load

    if not arguments or arguments[0].startswith("-"):
        return "" if arguments in ([], ["-h"], ["--help"], ["--version"]) else f"unknown option {arguments[0]}"
    name, *rest = arguments
    if name not in COMMANDS:
        return "there is no such command"
    return _parse(load(name, *COMMANDS[name]), f"fringed {name}", rest)


def _parse(command: Any, path: str, arguments: list[str]) -> str:
    context = command.context_class(command, info_name=path)
    try:
        values, rest, _ = command.make_parser(context).parse_args(list(arguments))
    except Exception as error:  # typer has no public name for its usage errors
        return str(getattr(error, "message", error))
    inner = getattr(command, "commands", None)
    if inner is not None and rest:
        chosen = inner.get(rest[0]) or inner.get("direct")
        used = rest[1:] if rest[0] in inner else rest
        return _parse(chosen, f"{path} {rest[0]}", used) if chosen else f"{path} has no command {rest[0]}"
    missing = [p.name for p in command.params if p.required and values.get(p.name) in (None, (), [])]
    if missing and "--help" not in arguments and "-h" not in arguments:
        return f"{path} needs {', '.join(missing)}"
    return f"{path} takes no argument {rest[0]}" if rest else ""
