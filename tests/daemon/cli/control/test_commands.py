"""The commands for a running daemon, and the live page."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator

import pytest
from rich.console import Console

from daemon.cli import command_table
from daemon.cli.control.get import bounds, list_text
from daemon.cli.control.set import parsed
from daemon.cli.control.status_page import page, watch
from daemon.cli.control.status_rows import table
from daemon.control.rpc.server import ControlServer
from fringed.errors import ControlError
from tests.daemon.running_daemon import Running, warmed


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Running, str]]:
    path = tmp_path_factory.mktemp("rig")
    running = warmed(path)
    server = ControlServer(f"ipc://{path}/c", running.methods)
    server.start()
    yield running, server.endpoint
    server.close()
    running.stop()


@pytest.fixture
def typed(daemon: tuple[Running, str], capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    def run(*arguments: str) -> str:
        assert command_table.invoke([*arguments, "--endpoint", daemon[1], "--timeout", "60"]) == 0
        return capsys.readouterr().out

    return run


def test_a_setting_is_shown_set_and_restored_by_a_reload(typed: Callable[..., str]) -> None:
    shown = typed("get", "pairing.tolerance_us")
    assert "pairing.tolerance_us = 2000.0 µs" in shown and "can be set live" in shown
    assert typed("set", "pairing.tolerance_us", "1800") == "pairing.tolerance_us = 1800.0\n"
    assert json.loads(typed("get", "pairing.tolerance_us", "--json")) == 1800.0
    assert typed("reload") == "changed: pairing.tolerance_us\n"
    assert typed("reload") == "nothing has changed\n"


def test_a_negative_number_is_a_value(typed: Callable[..., str]) -> None:
    assert typed("set", "pipeline.settings.window_radius", "-1") == "pipeline.settings.window_radius = -1\n"


def test_all_settings_are_listed(typed: Callable[..., str]) -> None:
    everything, live = typed("get"), typed("get", "--live")
    assert "device.name = rig-01  (needs a restart)" in everything and "device.name" not in live
    assert "pipeline.overload = skip  (skip | half, live)" in live


def test_a_refusal_raises_the_daemons_message(daemon: tuple[Running, str]) -> None:
    with pytest.raises(ControlError, match=r"device\.name cannot be set live"):
        command_table.invoke(["set", "device.name", "x", "--endpoint", daemon[1], "--timeout", "60"])


def test_a_daemon_pauses_resumes_and_writes_a_snapshot(typed: Callable[..., str]) -> None:
    assert typed("stop") == "paused\n"
    assert typed("start") == "running\n"
    assert "points, trigger" in typed("snapshot", "--name", "office")
    assert typed("pattern", "black") == "shown: black\n" and typed("pattern", "fringe") == "shown: fringe\n"


def test_the_status_is_printed_once_without_a_terminal(typed: Callable[..., str]) -> None:
    assert "state" in typed("status") and json.loads(typed("status", "--json"))["state"] == "running"


@pytest.mark.parametrize("width", [80, 120])
def test_the_page_fits_the_terminal(daemon: tuple[Running, str], width: int) -> None:
    status = json.loads(json.dumps(daemon[0].call("status")))
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(page(status, width, "no daemon answers"))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= width and len(lines) < 45
    text = "\n".join(lines)
    assert all(part in text for part in ("RUNNING", "clouds", "left", "right", "recorder", "no daemon answers"))


def test_table_and_page_name_what_the_first_cloud_waits_for(daemon: tuple[Running, str]) -> None:
    status = json.loads(json.dumps(daemon[0].call("status")))
    assert "first cloud" not in table(status)
    status |= {"clouds": 0, "cameras": {side: camera | {"frames": 0} for side, camera in status["cameras"].items()}}
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(page(status, 120))
    for shown in (table(status), console.export_text()):
        assert "waiting for the trigger: no frame from camera left and right yet" in shown


def test_the_page_waits_for_a_daemon_that_does_not_answer() -> None:
    answers = iter([ControlError("no answer"), ControlError("no answer")])

    def ask() -> dict[str, object]:
        raise next(answers, KeyboardInterrupt)

    console = Console(width=80, record=True, quiet=True)
    watch(ask, console, sleep=lambda _: None)


def test_a_value_that_is_no_json_is_text() -> None:
    assert [parsed(text) for text in ("7", "true", "half", '{"a": 1}')] == [7, True, "half", {"a": 1}]


def test_bounds_are_formatted_in_few_characters() -> None:
    assert [bounds(row) for row in ({"min": 0, "max": 5}, {"above": 0, "max": 5}, {"max": 5}, {"min": 1}, {})] == [
        "0 to 5",
        "> 0, up to 5",
        "at most 5",
        "from 1",
        "",
    ]
    assert list_text([]) == ""
