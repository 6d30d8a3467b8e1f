"""``make bench``: speed, memory, scale and accuracy, and other programs on the same images, in one run.

All jobs are timed one after the other, each of ours in a process of its own; figures are medians, and the spread shows
other load of the machine. Results go to ``out/bench/results.json``, figures beside them; ``--markdown`` writes tables
and figures into the documents. The exit code is 1 if a promise is not kept.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import trust
from benchmarks.accuracy import coverage
from benchmarks.common.tables import Table, as_json, with_block, write_whole
from benchmarks.reconstruction import compare, machine, roofline, scale, speed
from benchmarks.reconstruction.cases import CASES, HARD
from benchmarks.reconstruction.rendered import OUT

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "explanation" / "performance.md"
IMAGES = ROOT / "docs" / "images"
QUICK_CASES = 3

SectionResult = tuple[list[Table], Any, list[tuple[str, bool]]]


def stages(options: argparse.Namespace) -> SectionResult:
    """Time by stage, and memory."""
    table, memory, timings = speed.by_stage(options.repeats)
    figures = {name: asdict(timing) for name, timing in timings.items()}
    return [table, memory], figures, speed.promises(timings[f"three-chip/{speed.THREADS[-1]}"])


def live(options: argparse.Namespace) -> SectionResult:
    """The moving scene."""
    table, ways, timings = speed.live(options.repeats, 4 if options.quick else speed.FRAMES)
    return [table, ways], {name: asdict(timing) for name, timing in timings.items()}, []


def limits(options: argparse.Namespace) -> SectionResult:
    """Stages against the limits of memory and arithmetic."""
    table, figures = roofline.against_limits(options.repeats)
    return [table], figures, []


def peers(options: argparse.Namespace) -> SectionResult:
    """Other programs."""
    table, figures, promises = compare.compare(options.repeats, quick=options.quick)
    return [table], figures, promises


def scaling(options: argparse.Namespace) -> SectionResult:
    """More pixels, more fringes, a deeper volume."""
    table, figures = scale.by_series(options.repeats, quick=options.quick)
    return [table], figures, []


def cases(options: argparse.Namespace) -> SectionResult:
    """Accuracy by case."""
    chosen = [case for case in CASES if options.case in case.name]
    # The first cases are those that carry promises or a table of their own in the README.
    table, figures, promises = coverage.by_case(chosen[: QUICK_CASES if options.quick else None], options.seeds)
    return [table], figures, promises


def trust_section(options: argparse.Namespace) -> SectionResult:
    """Wrong points, false surfaces and error against sigma in hard cases."""
    chosen = [case for case in HARD if options.case in case.name]
    return trust.by_case(chosen[: QUICK_CASES if options.quick else None], options.seeds)


SECTIONS: dict[str, Callable[[argparse.Namespace], SectionResult]] = {
    "stages": stages,
    "live": live,
    "roofline": limits,
    "peers": peers,
    "scale": scaling,
    "accuracy": cases,
    "trust": trust_section,
}


def main() -> int:
    """Run the benchmark."""
    options = arguments(sys.argv[1:])
    console = Console(width=None if sys.stdout.isatty() else 160)
    begin = time.monotonic()
    about = machine.describe()
    tables: list[Table] = []
    figures: dict[str, Any] = {}
    promises: list[tuple[str, bool]] = []
    for name, section in SECTIONS.items():
        if name not in options.only:
            continue
        console.print(f"[dim]{name} ({time.monotonic() - begin:.0f} s)[/dim]")
        section_tables, figures[name], promised = section(options)
        tables += section_tables
        promises += promised
        for table in section_tables:
            table.print(console)
    for what, kept in promises:
        console.print(f"{'kept  ' if kept else 'MISSED'} {what}", highlight=False)
    about["took"] = f"{(time.monotonic() - begin) / 60:.1f} min"
    tables.insert(0, machine.table(about))
    tables[0].print(console)
    results = OUT / "results.json"
    write_whole(results, as_json(tables, about, figures))
    console.print(f"{results}")
    plot(results, IMAGES if options.markdown else OUT)
    if options.markdown:
        write_document(DOCUMENT, tables)
    return 0 if all(kept for _, kept in promises) else 1


def arguments(given: list[str]) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer pairs, cases and peers: within three minutes")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), help="these sections alone")
    parser.add_argument("--no-peers", action="store_true", help="leave other programs out")
    parser.add_argument("--case", default="", help="of the accuracy cases those whose name contains this")
    parser.add_argument("--seeds", type=int, default=1, help="noise and texture seeds to average over")
    parser.add_argument("--repeats", type=int, help="pairs to time (15, with --quick 5)")
    parser.add_argument("--markdown", action="store_true", help=f"write {DOCUMENT.name} and its figures")
    options = parser.parse_args(given)
    options.repeats = options.repeats or (5 if options.quick else 15)
    if options.quick and options.only == list(SECTIONS):
        options.only.remove("roofline")  # it may compile every kernel
    if options.no_peers:
        options.only = [name for name in options.only if name != "peers"]
    if options.markdown and (options.quick or options.case or set(options.only) != set(SECTIONS)):
        parser.error("--markdown requires the whole benchmark: a document does not mix measurements of different runs")
    return options


def write_document(file: Path, tables: list[Table]) -> None:
    """Put every table into its block."""
    text = file.read_text()
    for table in tables:
        text = with_block(text, table.name, table.markdown())
    write_whole(file, text)


def plot(results: Path, folder: Path) -> None:
    """Draw the figures, in the environment that has matplotlib."""
    if not compare.PYTHON.exists():
        print("no figures: .bench-venv is not there (`make bench` makes it)")
        return
    plots = ROOT / "benchmarks/reconstruction/plots.py"
    subprocess.run([compare.PYTHON, plots, results, folder], timeout=120, check=True)


if __name__ == "__main__":
    sys.exit(main())
