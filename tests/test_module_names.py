"""Modules that are named by text (tables, child processes, commands in documents) can be imported."""

from __future__ import annotations

import importlib
import importlib.util
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.apps.doctor.check_table import AREAS
from daemon.cli.command_table import COMMANDS, load
from daemon.config import driver_table

ROOT = Path(__file__).parents[1]
PACKAGES = "benchmarks", "daemon", "drivers", "fringed", "pipeline", "sim", "tests", "tools"
DRIVERS = [driver_table.SIM_OPTIONS]
for table in (driver_table.RIGS, driver_table.CAMERAS, driver_table.PROJECTORS):
    DRIVERS += [target for target in table.values() if not target.startswith("tests.")]
_NAME = rf"(?:{'|'.join(PACKAGES)})(?:\.\w+)+"
_COMMAND = re.compile(rf"-m ({_NAME})")
_LITERAL = re.compile(rf"[\"']({_NAME}(?::\w+)?)[\"']")
_NO_MODULES = (
    re.compile(
        r"(pipeline\.(settings|overload|calibration_check|temporal_prior|temporal|threads|nothing)|sim\.(layout|optics|faults))\b.*"
    ),
    re.compile(r"(fringed|benchmarks)\.\w+(\.left|\.json)?|.*\.log"),
)
"""Keys of rig.yaml; loggers, units and files."""


def function(target: str) -> object:
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


def sources(*suffixes: str) -> Iterator[Path]:
    for folder in (*PACKAGES, "docs", "examples", "systemd"):
        yield from (path for path in sorted((ROOT / folder).rglob("*")) if path.suffix in suffixes)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_is_there(name: str) -> None:
    assert load(name, *COMMANDS[name]).name == name


@pytest.mark.parametrize("target", [check.target for check in AREAS] + DRIVERS)
def test_each_check_and_driver_is_there(target: str) -> None:
    assert callable(function(target))


def test_the_installed_program_is_there() -> None:
    project = tomllib.loads((ROOT / "distributions" / "rig" / "pyproject.toml").read_text())["project"]
    targets = [*project["scripts"].values(), *project["entry-points"]["fringed.readers"].values()]
    assert all(callable(function(target)) for target in targets)


def test_every_program_that_a_text_starts_by_its_module_is_there() -> None:
    paths = [ROOT / "Makefile", ROOT / "README.md", *sources(".py", ".md", ".service", ".yaml")]
    named = {(name, path) for path in paths for name in _COMMAND.findall(path.read_text())}
    assert len(named) > 20
    for name, path in named:
        spec = importlib.util.find_spec(name)
        assert spec is not None, f"{path} starts {name}, which does not exist"
        if spec.submodule_search_locations is not None:
            assert importlib.util.find_spec(f"{name}.__main__"), f"{path} starts {name}, which has no __main__"


def exists(name: str) -> bool:
    """Whether it is a module, or something within one, at any depth and after a dot or a colon."""
    parts = re.split("[.:]", name)
    for length in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def test_every_literal_that_is_a_module_s_name_names_one() -> None:
    named = {
        (name, str(path.relative_to(ROOT))) for path in sources(".py") for name in _LITERAL.findall(path.read_text())
    }
    checked = [each for each in sorted(named) if not any(no.fullmatch(each[0]) for no in _NO_MODULES)]
    assert len(checked) > 80
    assert [each for each in checked if not exists(each[0])] == []
