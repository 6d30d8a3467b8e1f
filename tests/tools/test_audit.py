"""The audit of dependencies: a finding fails, a missing answer does not count as safe."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

_PATH = Path(__file__).resolve().parents[2] / "tools" / "audit.py"


@pytest.fixture
def audit() -> Any:
    spec = importlib.util.spec_from_file_location("fringed_audit", _PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def package(name: str, *problems: str) -> dict[str, Any]:
    return {"name": name, "version": "1.0", "vulns": [{"id": one, "fix_versions": ["1.1"]} for one in problems]}


def run(audit: Any, monkeypatch: pytest.MonkeyPatch, folder: Path, answers: dict[str, list[str]]) -> int:
    constraints = folder / "constraints.txt"
    constraints.write_text("good==1.0\nother==1.0\n")
    monkeypatch.setattr(audit, "installed", lambda _: ["pip-audit"])
    monkeypatch.setattr(audit, "vulnerable", lambda pinned, *_: answers[pinned[0]])
    return int(audit.main([str(constraints)]))


def test_a_finding_fails(
    audit: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = {audit.KNOWN_BAD: ["yes"], "good==1.0": ["good 1.0: CVE-1"]}
    assert run(audit, monkeypatch, tmp_path, answers) == 1
    assert "good 1.0: CVE-1" in capsys.readouterr().out


def test_no_finding_of_a_source_that_lists_the_known_vulnerability_passes(
    audit: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(audit, monkeypatch, tmp_path, {audit.KNOWN_BAD: ["yes"], "good==1.0": []}) == 0
    assert "2 packages audited, 0 known" in capsys.readouterr().out


def test_a_source_without_the_known_vulnerability_is_not_used(
    audit: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(audit, monkeypatch, tmp_path, {audit.KNOWN_BAD: [], "good==1.0": []}) == 0
    assert capsys.readouterr().out.startswith("NOT AUDITED")


def test_packages_without_an_answer_are_not_counted_as_safe(audit: Any) -> None:
    assert audit.findings({"dependencies": [package("a"), package("b", "CVE-2")]}, 2) == ["b 1.0: CVE-2, fixed in 1.1"]
    skipped = {"name": "b", "skip_reason": "not found"}
    with pytest.raises(audit.NotAuditedError, match="1 of 2"):
        audit.findings({"dependencies": [package("a"), skipped]}, 2)
