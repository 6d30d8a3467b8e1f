"""What the pages state about commands, settings, limits and messages is what the program has."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from daemon.apps.doctor.check_table import AREAS
from daemon.cli import command_table
from daemon.config.load import parse_rig
from daemon.config.presets import BUILT_IN, MEANINGS
from daemon.config.rig_config import RigConfig
from daemon.control.settings.catalogue import catalogue
from daemon.monitoring.health import quantities
from fringed.protocol import methods, topics
from pipeline.common.settings import LIMITS, RENAMED, Settings
from pipeline.monitor import OBSERVABLES
from tools.docs import command_lines, reference
from tools.docs.pages import DOCS, ROOT, blocks, pages, spans

CONFIG = parse_rig("cameras: {driver: sim}\n")
PATHS = {row["path"]: row for row in catalogue(CONFIG, Settings())}
TROUBLESHOOTING = DOCS / "how-to" / "troubleshooting.md"
INCOMPLETE = re.compile(r" needs | requires an argument")
"""A command that is named without its arguments."""
COMMANDS = {"fringed", "systemctl", "echo", "python"}
OTHER_OPTIONS = {"--transform", "--no-block"}
"""Options of xrandr and systemctl."""
FOR_USERS = [page for page in pages() if page.parent.name in ("start", "how-to", "reference")]
PLACEHOLDER = re.compile(r"[A-Z]{2,}|[|\[]")
"""In an inline command: a word in capitals, or a choice."""


def rows(page: Path, heads: str) -> Iterator[list[str]]:
    """The cells of every row of the tables whose first line begins with these heads."""
    inside = False
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"| {heads}"):
            inside = True
        elif not line.startswith("|"):
            inside = False
        elif inside and not line.startswith("| ---"):
            yield [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def code(cell: str) -> list[str]:
    """The texts in backticks."""
    return re.findall(r"`([^`]+)`", cell)


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_every_inline_command_is_accepted_by_its_parser(page: Path) -> None:
    wrong = []
    for line, text in spans(page):
        if text.startswith(("fringed ", "make ")) and not PLACEHOLDER.search(text):
            found = command_lines.check(text)
            wrong += [f"line {line}: {problem}" for problem in found if not INCOMPLETE.search(problem)]
            if setting := re.match(r"fringed (?:set|get) ([a-z][\w.]*)", text):
                known = [path for path in PATHS if path == setting[1] or path.startswith(f"{setting[1]}.")]
                wrong += [f"line {line}: there is no setting {setting[1]}"] * (not known)
    assert wrong == []


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_every_setting_that_a_page_names_exists(page: Path) -> None:
    sections = set(RigConfig.model_fields) - {"cameras", "projector", "simulation", "calibration", "pattern", "volume"}
    known = {*PATHS, *(path.rpartition(".")[0] for path in PATHS), *(method.name for method in methods.METHODS)}
    wrong = []
    for line, text in spans(page):
        path = text.partition(":")[0].partition(" ")[0]
        section, dot, _ = path.partition(".")
        if dot and section in sections and re.fullmatch(r"[a-z_]+(\.[a-z_]+)+", path):
            other = path.endswith((".json", ".yaml", ".npz", ".html")) or (ROOT / path.replace(".", "/")).exists()
            wrong += [f"line {line}: {path}"] * (path not in known and not other)
    assert wrong == []


@cache
def options() -> frozenset[str]:
    """Every option of every command."""

    def of(command: Any) -> Iterator[str]:
        for parameter in command.params:
            yield from (name for name in (*parameter.opts, *parameter.secondary_opts) if name.startswith("--"))
        for inner in (getattr(command, "commands", None) or {}).values():
            yield from of(inner)

    found = {"--version", "--help", "--debug"}
    for name, (target, summary) in command_table.COMMANDS.items():
        found |= set(of(command_table.load(name, target, summary)))
    return frozenset(found)


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_option_topic_and_method_that_a_page_names_exists(page: Path) -> None:
    topic_names = {topic.name for topic in topics.TOPICS}
    method_names = {method.name for method in methods.METHODS}
    groups = {name.partition(".")[0] for name in method_names if "." in name}
    wrong = []
    for line, text in spans(page):
        first = text.split()[0].partition("=")[0]
        if first.startswith("--") and first not in options() | OTHER_OPTIONS:
            wrong.append(f"line {line}: option {first}")
        if re.fullmatch(r"(cloud|meta)/[a-z]+", text) and text not in topic_names:
            wrong.append(f"line {line}: topic {text}")
        group, dot, _ = text.partition(".")
        if dot and group in groups and re.fullmatch(r"[a-z.]+[a-z_]+", text) and text not in {*method_names, *PATHS}:
            wrong += [f"line {line}: method {text}"] * (not text.endswith((".json", ".yaml", ".sync", ".synced")))
    assert wrong == []


DEFAULTS = [
    pytest.param("how-to/recording.md", "recording", id="recording"),
    pytest.param("reference/health.md", "health", id="health"),
]


@pytest.mark.parametrize(("name", "section"), DEFAULTS)
def test_a_block_of_defaults_has_every_default(name: str, section: str) -> None:
    (shown,) = (
        data[section]
        for block in blocks(DOCS / name)
        if block.language == "yaml" and section in (data := yaml.safe_load(block.text))
    )
    actual = CONFIG.model_dump(mode="json")[section]
    assert shown == actual


def test_the_settings_page_has_the_default_of_every_setting_of_the_reconstruction() -> None:
    page = reference.settings()
    for name, value in dataclasses.asdict(Settings()).items():
        assert f"| `pipeline.settings.{name}` | `{json.dumps(value)}` |" in page


def test_the_filters_page_names_every_setting_of_the_filters_with_a_value_that_switches_it_off() -> None:
    named = set()
    for _, settings, _, off, *_ in rows(DOCS / "reference" / "filters.md", "filter | settings"):
        names = [name for name in code(settings) if name in LIMITS]
        named |= set(names)
        for name, value in zip(names, off.split(","), strict=False):
            if re.fullmatch(r"[\d.]+", value.strip()):
                low, high = LIMITS[name]
                assert low <= float(value) <= high, f"{name} {value}"
                assert float(value) in (low, high, 0.0, 1.0), f"{name} {value} does not switch it off"
    doc = {path.rpartition(".")[2]: row["doc"] for path, row in PATHS.items()}
    filters = {name for name in LIMITS if re.match(r"\w+( \w+)? filter:|Smoothing|Hole|Region|Down", doc[name])}
    shortened = {name for name in filters if name.startswith("roi_")}
    assert filters - shortened <= named
    text = (DOCS / "reference" / "filters.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in text for name in RENAMED)


def test_the_presets_on_the_page_are_those_of_the_program() -> None:
    shown = {code(name)[0]: meaning for name, meaning in rows(DOCS / "reference" / "filters.md", "preset | for")}
    assert shown == MEANINGS and shown.keys() == BUILT_IN.keys()


def test_the_areas_of_the_doctor_are_those_of_the_program() -> None:
    assert [area for area, _ in rows(DOCS / "how-to" / "doctor.md", "area | checks")] == [one.area for one in AREAS]


def test_every_quantity_of_health_is_on_its_page() -> None:
    page = DOCS / "reference" / "health.md"
    shown = {name for cells in rows(page, "quantities | meaning") for name in code(cells[0])}
    assert shown <= set(quantities.NAMES), "these do not exist"
    ranges = {n for n in quantities.NAMES if n.startswith(("saturated_", "modulation_"))}  # first ... last
    assert set(quantities.NAMES) - ranges - {"degraded"} <= {*shown, *(text for _, text in spans(page))}


@cache
def texts() -> tuple[str, ...]:
    """Every text in the program's sources, a field of a format as ``...``."""
    found = []
    for package in ("fringed", "pipeline", "drivers", "daemon"):
        for file in (ROOT / package).rglob("*.py"):
            inner: set[int] = set()
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):  # a node before its parts
                if isinstance(node, ast.JoinedStr):
                    inner |= set(map(id, node.values))
                if id(node) not in inner:
                    found.append(_text(node))
    return tuple(filter(None, found))


def _text(node: Any) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"\{\w*\}|%s", "...", node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) or "..." for part in node.values)
    return ""


def printed(message: str) -> bool:
    """Whether the program has a text with all parts of the message between ``...``, in their order."""
    parts = [re.escape(part.strip()) for part in message.split("...") if part.strip()]
    pattern = re.compile(".*".join(parts), re.DOTALL)
    return any(pattern.search(text) for text in texts())


def messages(page: Path) -> Iterator[str]:
    """The quoted texts of symptoms and proofs: those with a space that are no command."""
    for symptom, _, proof, _ in rows(page, "symptom | cause"):
        yield from (text for text in code(symptom) + code(proof) if " " in text and text.split()[0] not in COMMANDS)


@pytest.mark.parametrize("message", list(messages(TROUBLESHOOTING)))
def test_every_quoted_message_is_one_of_the_program(message: str) -> None:
    assert printed(message)


def test_a_message_that_the_program_does_not_have_is_found() -> None:
    assert printed("the X library ... is missing") and not printed("the Y library ... is missing")
    assert not printed("is missing ... the X library")


def test_every_name_in_the_symptoms_and_proofs_is_one_of_the_program() -> None:
    known = {*PATHS, *(path.rpartition(".")[2] for path in PATHS), *quantities.NAMES, *OBSERVABLES}
    wrong = []
    for symptom, _, proof, _ in rows(TROUBLESHOOTING, "symptom | cause"):
        for name in code(symptom) + code(proof):
            if re.fullmatch(r"[a-z]+(_[a-z]+)+", name) and name not in known:
                wrong += [name] * (not any(name in text for text in texts()))
    assert wrong == []
