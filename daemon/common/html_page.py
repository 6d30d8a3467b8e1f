"""HTML pages: head, style, cards, tables; well-formed XML, so that programs can parse them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

STYLE = """
:root { --ink: #1d2733; --dim: #66727f; --line: #dde3e9; --soft: #f5f7f9; --blue: #1668b0; --red: #c8372d;
  --green: #1d7d4a; --amber: #a86500; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 24px 60px; }
h1 { font-size: 26px; margin: 0 0 4px; letter-spacing: -0.01em; }
h2 { font-size: 18px; margin: 38px 0 10px; padding-bottom: 6px; border-bottom: 1px solid var(--line); }
h3 { font-size: 15px; margin: 18px 0 6px; }
p { margin: 6px 0 10px; max-width: 80ch; }
.dim, figcaption { color: var(--dim); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(180px, 1fr)); gap: 10px; margin: 20px 0; }
.card { border: 1px solid var(--line); border-radius: 8px; padding: 10px 14px; background: var(--soft); }
.card b { display: block; font-size: 23px; font-weight: 600; font-variant-numeric: tabular-nums; }
.card b small { font-size: 14px; white-space: nowrap; font-weight: 400; color: var(--dim); }
.card span { color: var(--dim); font-size: 13px; }
.good b { color: var(--green); } .warn b { color: var(--amber); } .bad b { color: var(--red); }
.grid { display: grid; grid-template-columns: repeat(2, 1fr); gap: 16px; }
.tables { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 0 36px; }
.wide { grid-template-columns: repeat(auto-fit, minmax(540px, 1fr)); }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(320px, 1fr)); gap: 20px; }
figure { margin: 0; }
figcaption { font-size: 13px; padding-top: 4px; }
svg { display: block; width: 100%; height: auto; border-radius: 4px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { padding: 4px 14px 4px 0; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { color: var(--dim); font-weight: 500; }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
td.text { white-space: normal; }
tr.out td { color: var(--red); }
.scroll { overflow-x: auto; }
ul { padding-left: 20px; margin: 6px 0; } li { margin: 3px 0; max-width: 90ch; }
@media print { main { max-width: none; padding: 0; } figure, .card, tr { break-inside: avoid; } }
"""


@dataclass(frozen=True, slots=True)
class Card:
    """One figure at the top: ``level`` is good, warn, bad or nothing."""

    label: str
    value: str
    unit: str = ""
    level: str = ""


def page(title: str, lines: Sequence[str], cards: Sequence[Card], sections: Iterable[tuple[str, str]]) -> bytes:
    """The file: title, lines below it, figures, then sections of (heading, HTML)."""
    out = [
        '<!DOCTYPE html>\n<html xmlns="http://www.w3.org/1999/xhtml" lang="en">\n<head>\n<meta charset="utf-8"/>\n',
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>\n',
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{escape(title)}</h1>\n",
        *(f'<p class="dim">{escape(line)}</p>\n' for line in lines),
        '<div class="cards">\n',
        *(card(one) for one in cards),
        "</div>\n",
    ]
    out += [f"<section>\n<h2>{escape(heading)}</h2>\n{body}\n</section>\n" for heading, body in sections if body]
    out.append("</main>\n</body>\n</html>\n")
    return "".join(out).encode()


def card(one: Card) -> str:
    """One figure with its label."""
    unit = f" <small>{escape(one.unit)}</small>" if one.unit else ""
    return f'<div class="card {one.level}"><span>{escape(one.label)}</span><b>{escape(one.value)}{unit}</b></div>\n'


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Iterable[int] = (), out: Iterable[int] = ()
) -> str:
    """A table; ``text``: columns of text, ``out``: rows in red."""
    textual, red = set(text), set(out)

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f'<{tag} class="text">{escape(cell)}</{tag}>' if n in textual else f"<{tag}>{escape(cell)}</{tag}>"
            for n, cell in enumerate(row)
        )

    body = "".join(
        f"<tr{' class=' + chr(34) + 'out' + chr(34) if n in red else ''}>{cells('td', row)}</tr>\n"
        for n, row in enumerate(rows)
    )
    return f'<div class="scroll"><table>\n<tr>{cells("th", head)}</tr>\n{body}</table></div>\n'


def items(texts: Iterable[str]) -> str:
    """A list of sentences; nothing if there are none."""
    rows = "".join(f"<li>{escape(text)}</li>\n" for text in texts)
    return f"<ul>\n{rows}</ul>\n" if rows else ""


def figure(svg: str, caption: str) -> str:
    """A drawing with its caption."""
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>\n"
