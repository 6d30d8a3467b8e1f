"""The report as an HTML page: figures, histograms, the worst recordings, failures, all recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from daemon.common.html_page import Card, items, page, table

_TITLES = {
    "coverage": ("Coverage: share of the pixels with a point", "{:.2f}"),
    "rejected": ("Rejected: share of the lit pixels without a point", "{:.2f}"),
    "total_ms": ("Time of a pair in its worker, ms", "{:.0f}"),
}
_HEAD = ("recording", "pairs", "done", "points", "coverage", "rejected", "ms", "consistency", "state")
_WIDTH, _HEIGHT = 560, 150
_LISTED_FAILURES = 200


def report_page(values: Mapping[str, Any]) -> bytes:
    """The page of a report's values."""
    rows = {row["name"]: row for row in values["per_recording"]}
    lines = [
        f"{values['recordings']} recordings, {values['bytes'] / 1e9:.2f} GB; settings changed: "
        f"{_settings(values['changed_settings'])}; calibration: {values['job']['calibration'] or 'the attached ones'}; "
        f"release: {', '.join(f'{name} {number}' for name, number in values['job']['release'].items())}"
    ]
    return page(
        "Reprocessing",
        lines,
        _cards(values),
        [
            ("Failures", items(values["failures"][:_LISTED_FAILURES])),
            ("Distribution over all pairs", _histograms(values["histograms"])),
            ("The ten worst recordings", _table(rows[name] for name in values["worst"])),
            ("All recordings", _table(rows.values())),
        ],
    )


def grid_page(values: Mapping[str, Any]) -> bytes:
    """The page of a comparison of settings."""
    names = list(dict.fromkeys(name for row in values["rows"] for name in row["settings"]))
    body = [grid_cells(row, names) for row in values["rows"]]
    failures = [text for row in values["rows"] for text in row["failures"]]
    line = f"{len(body)} combinations on a sample of {values['sample']} pairs"
    sections = [
        ("Combinations", table((*names, *GRID_HEAD), body, text=(len(names) + 5,))),
        ("Failures", items(failures)),
    ]
    return page("Comparison of settings", [line], [], sections)


GRID_HEAD = ("pairs", "coverage", "rejected", "points", "ms", "consistency")


def grid_cells(row: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """The cells of a combination: values of the settings, then as in the head."""
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in row["verdicts"].items())
    figures = (
        f"{100 * row['coverage']:.2f} %",
        f"{100 * row['rejected']:.2f} %",
        f"{row['points']:.0f}",
        f"{row['ms']:.1f}",
    )
    return [*(str(row["settings"].get(name, "")) for name in names), str(row["clouds"]), *figures, verdicts]


def _settings(changed: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in changed.items()) or "none"


def _cards(values: Mapping[str, Any]) -> list[Card]:
    means, failed = values["means"], len(values["failures"])
    refuted = means["verdicts"].get("inconsistent", 0)
    missing = values["items"] - values["done"]
    return [
        Card("pairs done", f"{values['done']}", f"of {values['items']}", "bad" if missing else "good"),
        Card("failures", str(failed), "", "bad" if failed else "good"),
        Card("contradict the calibration", str(refuted), "pairs", "warn" if refuted else "good"),
        Card("coverage", f"{100 * means['coverage']:.1f}", "%"),
        Card("points of a cloud", f"{means['points']:.0f}"),
        Card("rate", f"{values['items_per_second']:.2f}", "pairs/s"),
        Card("time", f"{values['seconds']:.0f}", "s"),
    ]


def _table(rows: Iterable[Mapping[str, Any]]) -> str:
    body: list[Sequence[str]] = []
    out: list[int] = []
    for number, row in enumerate(rows):
        if row["failures"]:
            out.append(number)
        body.append(
            (
                row["name"], str(row["items"]), str(row["done"]), f"{row['points']:.0f}",
                f"{100 * row['coverage']:.1f} %", f"{100 * row['rejected']:.1f} %", f"{row['ms']:.0f}",
                ", ".join(f"{count} {verdict}" for verdict, count in row["verdicts"].items()), _state(row),
            )
        )  # fmt: skip
    html = table(_HEAD, body, text=(0, 7, 8), out=out)
    for name, _, done, *_ in body:  # the names of recordings with results become links to their folders
        text = escape(name)
        if done != "0":
            link = f'<td class="text"><a href="{quote(name)}/">{text}</a></td>'
            html = html.replace(f'<td class="text">{text}</td>', link, 1)
    return html


def _state(row: Mapping[str, Any]) -> str:
    parts = [str(text) for text in (*row["failures"], *row["problems"])][:2]
    if row["failed"]:
        parts.append(f"{row['failed']} pairs rejected by the pipeline")
    if row["damaged"]:
        parts.append(f"{row['damaged']} damaged frames")
    return "; ".join(parts)


def _histograms(histograms: Mapping[str, Mapping[str, Any]]) -> str:
    figures = [
        f"<figure>{_bars(histogram['edges'], histogram['counts'], _TITLES[name][1])}"
        f"<figcaption>{escape(_TITLES[name][0])}</figcaption></figure>"
        for name, histogram in histograms.items()
        if name in _TITLES
    ]
    return f'<div class="pair">{"".join(figures)}</div>'


def _bars(edges: Sequence[float], counts: Sequence[int], form: str) -> str:
    """A bar for each bin, its edges below."""
    highest, step = max(1, *counts), _WIDTH / len(counts)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT + 34}" role="img">']
    for n, count in enumerate(counts):
        height = _HEIGHT * count / highest
        title = f"{form.format(edges[n])} to {form.format(edges[n + 1])}: {count}"
        out.append(
            f'<rect x="{n * step + 1:.1f}" y="{14 + _HEIGHT - height:.1f}" width="{step - 2:.1f}" '
            f'height="{height:.1f}" fill="#1668b0"><title>{escape(title)}</title></rect>'
        )
    out.append(f'<line x1="0" y1="{_HEIGHT + 14}" x2="{_WIDTH}" y2="{_HEIGHT + 14}" stroke="#66727f"/>')
    for n in range(0, len(edges), max(1, len(counts) // 5)):
        anchor = "start" if n == 0 else "end" if n == len(edges) - 1 else "middle"
        out.append(
            f'<text x="{n * step:.1f}" y="{_HEIGHT + 30}" font-size="12" text-anchor="{anchor}" fill="#66727f">'
            f"{form.format(edges[n])}</text>"
        )
    out.append(f'<text x="0" y="11" font-size="12" fill="#66727f">{highest} pairs</text></svg>')
    return "".join(out)
