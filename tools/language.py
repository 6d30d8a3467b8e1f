"""Check identifiers and prose for retired words: ``python -m tools.language [--counts] [PATH ...]``.

Names in this project are the terms of the field. A retired word is reported with its line and the term that replaces
it: in identifiers (by sub-word), comments, docstrings, strings that contain a space, Markdown and file names. Code in
backticks, the fields of f-strings and the exceptions below are left out.
"""

from __future__ import annotations

import io
import keyword
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

TERMS = {
    "image": "picture pictures",
    "report, describe, state; tell apart: distinguish": "tell tells telling told say says saying said",
    "text, message": "words",
    "detect, inspect, examine": "look looks looked looking",
    "capture, captured images": "shot shots shoot shoots shooting",
    "request": "wish wishes wished",
    "latest-wins queue": "mailbox",
    "mode controller, locked pairer": "desk",
    "background executor": "lane",
    "temporal prior": "sequel",
    "outcome": "fate fates",
    "unpaired": "lone",
    "garbage collection; invalid data": "garbage",
    "conflict, occlusion, runner-up": "rival rivals contest contests contested prevails",
    "reject, mask": "conceal conceals concealed",
    "descriptor": "traits",
    "normalise": "equalise equalises equalised equalize equalized",
    "disturbance": "knock knocks knocked",
    "false match; overlay": "ghost ghosts",
    "again, restart": "anew",
    "chromatic correction": "straighten straightens straightened",
    "parameterisation": "freedom",
    "assessment": "judgement judgements judgment",
    "relative pose": "placing",
    "client": "crowd crowds",
}
IN_PROSE = {
    "have, hold, contain": "knows knew",
    "expect, require": "wants want",
    "the caller, the user, no one": "whoever anybody somebody everybody nobody",
    "(leave out)": "surely",
    "task": "affair affairs",
}
WORDS = {word: term for term, words in TERMS.items() for word in words.split()}
PROSE = WORDS | {word: term for term, words in IN_PROSE.items() for word in words.split()}

# What contains a retired word and stays, with the reason.
EXPRESSIONS = {
    r"single[- _]?shots?": "the method's name",
    r"shot[ _]noise": "photon noise",
    r"garbage[- _]collect\w*": "Python's memory management",
    r"degrees? of freedom": "statistics",
    r"look(s|ed|ing)?[- _]ups?": "a search in a table",
    r"\b(fates|garbage):": "fields of the status, in their description",
}
IDENTIFIERS = {
    "fates": "key of the status",
    "garbage": "key of the status",
    "lone_share": "key of rig.yaml",
    "lone_frames": "key of the status",
    "look": "key of the health report",
    "looks_hz": "key of rig.yaml",
    "break_long_words": "parameter of textwrap",
}
QUOTING = {"tools/language.py", "tests/tools/test_language.py", "docs/reference/protocol.md"}
"""Files that quote the retired words."""

_KEPT = re.compile("|".join(EXPRESSIONS), re.IGNORECASE)
_CODE = re.compile(r"```.*?```|``[^`]*``|`[^`\n]*`|https?://\S+", re.DOTALL)
_PART = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_FSTRING = getattr(tokenize, "FSTRING_MIDDLE", -1)


def in_identifier(name: str) -> list[str]:
    """Retired words among the sub-words of an identifier."""
    if keyword.iskeyword(name) or name in IDENTIFIERS:
        return []
    return [part for part in map(str.lower, _PART.findall(_KEPT.sub("", name))) if part in WORDS]


def in_prose(text: str) -> list[tuple[int, str]]:
    """Retired words in a text, each with the number of its line in it, from 0."""
    for pattern in (_CODE, _KEPT):
        text = pattern.sub(lambda found: "\n" * found[0].count("\n"), text)
    lines = enumerate(text.lower().split("\n"))
    return [(number, word) for number, line in lines for word in re.findall(r"[a-z_]+", line) if word in PROSE]


def in_python(source: str) -> Iterator[tuple[int, str]]:
    """Retired words of a Python file with their lines."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        line, text = token.start[0], token.string
        if token.type == tokenize.NAME:
            yield from ((line, word) for word in in_identifier(text))
        elif token.type in (tokenize.COMMENT, _FSTRING) or (token.type == tokenize.STRING and " " in text):
            if re.match(r"[rR]?[fF]", text):
                text = re.sub(r"\{[^{}]*\}", "", text)
            yield from ((line + number, word) for number, word in in_prose(text))


def findings(name: str, source: str) -> Iterator[tuple[int, str]]:
    """Retired words of a file with their lines, those of its name with line 0."""
    yield from ((0, word) for part in Path(name).with_suffix("").parts for word in in_identifier(part))
    yield from in_python(source) if name.endswith(".py") else ((n + 1, word) for n, word in in_prose(source))


def main(arguments: list[str]) -> int:
    """Print every retired word; 1 if there is one. ``--counts`` prints counts by folder and by word instead."""
    paths = [argument for argument in arguments if not argument.startswith("--")]
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *paths]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    folders: Counter[str] = Counter()
    words: Counter[str] = Counter()
    for name in names:
        if name in QUOTING or not name.endswith((".py", ".md", "Makefile")) or not (ROOT / name).is_file():
            continue
        for line, word in findings(name, (ROOT / name).read_text(encoding="utf-8")):
            folders["/".join(name.split("/")[:-1][:2])] += 1
            words[word] += 1
            if "--counts" not in arguments:
                sys.stdout.write(f"{name}:{line}: {word} -> {PROSE[word]}\n")
    if "--counts" in arguments:
        for counts in (folders, words):
            sys.stdout.writelines(f"{count:6} {key}\n" for key, count in counts.most_common())
    return int(bool(words))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
