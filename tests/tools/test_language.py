"""The language check refuses every retired word, wherever it stands, and leaves the exceptions alone."""

from __future__ import annotations

import pytest

from tools.language import EXPRESSIONS, IDENTIFIERS, PROSE, WORDS, findings


def lines(source: str, name: str = "module.py") -> list[tuple[int, str]]:
    return list(findings(name, source))


@pytest.mark.parametrize("word", PROSE)
def test_a_retired_word_is_refused_in_every_kind_of_prose(word: str) -> None:
    source = (
        f'"""One line.\n\nIt {word} here.\n"""\n\ntext = "it {word.title()}, twice"  # {word}\nname = f"{{x}} {word}"\n'
    )
    assert lines(source) == [(3, word), (6, word), (6, word), (7, word)]
    assert lines(f"# Title\n\nIt {word} here.\n", "page.md") == [(3, word)]


@pytest.mark.parametrize("word", WORDS)
def test_a_retired_word_is_refused_in_every_kind_of_identifier(word: str) -> None:
    title = word.title()
    if word not in IDENTIFIERS:
        assert lines(f"x_{word} = {word}2.y") == [(1, word)] * 2
    assert lines(f"class My{title}({title}Error):\n    def _{word}_of(self): ...\n") == [
        (1, word),
        (1, word),
        (2, word),
    ]
    assert lines("", f"tests/test_{word}_of.py") == [(0, word)]


@pytest.mark.parametrize("name", IDENTIFIERS)
def test_identifiers_of_the_list_stay(name: str) -> None:
    assert lines(f"status.{name} = {{}}") == []


def test_expressions_code_and_keys_stay() -> None:
    assert len(EXPRESSIONS) == 6
    assert (
        lines('"""Single-shot, shot noise, garbage collection, a look-up, two degrees of freedom.\n\n    fates: x\n"""')
        == []
    )
    assert lines('key = status["told"]  # in ``told`` and `look`') == []
    assert lines("A `look` at\n```\nit told\n```\nhttps://example.org/told\n", "page.md") == []
    assert lines("shutter, foretold, saying_not = shoulder, lookup, single_shot_noise") == [(1, "saying")]
