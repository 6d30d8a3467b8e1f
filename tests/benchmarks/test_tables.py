"""Tables, the file of results, and the documents that are written from them."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks.bench import DOCUMENT, SECTIONS, arguments, write_document
from benchmarks.common.tables import Table, as_json, marks, with_block, write_whole
from benchmarks.reconstruction import machine, speed
from benchmarks.reconstruction.worker import Timing


@pytest.fixture
def table() -> Table:
    found = Table("sizes", "By size", ["what", "kind", "ms"], text_columns=("kind",), notes=["Medians."])
    found.add("small", "fast", "1.5")
    found.add("large", "slow", "12.0")
    return found


def timing(scale: float) -> Timing:
    stages = {"decode": [scale, 3 * scale, 2 * scale], "orders": [4 * scale] * 3}
    return Timing([6 * scale, 5 * scale, 70 * scale], stages, ready_s=1.0, peak_mib=300.0, images_mib=5.0)


def test_a_row_has_a_cell_for_every_heading(table: Table) -> None:
    with pytest.raises(ValueError, match="2 cells, expected 3"):
        table.add("one", "two")


def test_markdown_and_terminal_show_every_cell_and_note(table: Table) -> None:
    lines = table.markdown().splitlines()
    assert lines[0] == "### By size"
    assert lines[2:] == [
        "| what | kind | ms |",
        "| --- | --- | --: |",
        "| small | fast | 1.5 |",
        "| large | slow | 12.0 |",
        "",
        "Medians.",
    ]
    shown = io.StringIO()
    table.print(Console(file=shown, width=100))
    assert all(word in shown.getvalue() for word in ("By size", "small", "slow", "12.0", "Medians."))


def test_results_are_read_back_as_they_were_measured(table: Table, tmp_path: Path) -> None:
    figures = {"sizes": {"ms": [1.5, 12.0]}}
    write_whole(tmp_path / "deep" / "results.json", as_json([table], {"cores": "2"}, figures))
    found = json.loads((tmp_path / "deep" / "results.json").read_text())
    assert found["machine"] == {"cores": "2"} and found["figures"] == figures
    assert found["tables"][0]["rows"] == [["small", "fast", "1.5"], ["large", "slow", "12.0"]]
    assert [file.name for file in (tmp_path / "deep").iterdir()] == ["results.json"]


def test_only_the_block_of_a_name_is_replaced_and_twice_is_once() -> None:
    text = "\n".join(["head", *marks("a"), "between", *marks("b"), "tail"])
    once = with_block(with_block(text, "a", "old"), "a", "new")
    assert "new" in once and "old" not in once
    assert once == with_block(once, "a", "new")
    assert once.split(marks("a")[1])[1] == text.split(marks("a")[1])[1]


@pytest.mark.parametrize("text", ["", "{0}", "{1}{0}", "{0}{0}{1}"])
def test_a_document_without_its_two_marks_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="needs one line"):
        with_block(text.format(*marks("a")), "a", "new")


def test_the_document_has_a_block_for_every_table(tmp_path: Path) -> None:
    copy = tmp_path / "performance.md"
    copy.write_text(DOCUMENT.read_text())
    names = ["machine", "stages", "roofline", "memory", "live", "live accuracy", "peers", "scale", "accuracy", "trust"]
    names += ["sigma"]
    write_document(copy, [Table(name, f"Title of {name}", ["a"]) for name in names])
    written = copy.read_text()
    assert [name for name in names if f"### Title of {name}\n" not in written] == []
    assert sorted(re.findall(r"<!-- measured: ([a-z ]+) \(", written)) == sorted(names)
    assert "(../images/" in written
    for image in re.findall(r"\(\.\./images/(.+?)\)", written):
        assert re.fullmatch(r"bench-(stages|peers|pixels|periods|depth)\.svg", image)


def test_stages_have_median_and_worst_and_the_whole_its_rate() -> None:
    table = speed.stage_table("stages", "t", {"three-chip/1": timing(2.0), "three-chip/2": timing(1.0)})
    assert list(table.headings) == ["stage", "three-chip, 1 thread", "three-chip, 2 threads", "budget"]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["decode"] == ("4.0 / 6.0", "2.0 / 3.0", "10")
    assert rows["all"] == ("12.0 / 140.0", "6.0 / 70.0", "33.3")
    assert rows["pairs a second"][:2] == ("83.3", "166.7")


def test_a_promised_rate_is_kept_or_missed_by_the_median() -> None:
    assert [kept for _, kept in speed.promises(timing(1.0))] == [True]
    assert [kept for _, kept in speed.promises(timing(10.0))] == [False]


@pytest.mark.parametrize("given", [["--quick"], ["--only", "stages"], ["--no-peers"], ["--case", "Bayer"]])
def test_a_document_is_written_by_a_whole_run_only(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    arguments(given)
    with pytest.raises(SystemExit):
        arguments([*given, "--markdown"])
    assert "whole benchmark" in capsys.readouterr().err


def test_everything_is_measured_by_default() -> None:
    assert arguments([]).only == list(SECTIONS) and arguments([]).repeats == 15
    assert arguments(["--quick"]).repeats < 15
    assert arguments(["--no-peers"]).only == [name for name in SECTIONS if name != "peers"]


def test_the_machine_is_described() -> None:
    about = machine.table({"cores": "2"})
    assert about.rows == [("cores", "2")]
    assert machine.copy_gb_per_s(repeats=1) > 0
