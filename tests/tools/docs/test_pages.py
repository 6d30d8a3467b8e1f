"""Links of the documentation lead somewhere, generated tables are current, and the site builds without a warning."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.renders import render_pair
from tools.docs import noise, reference
from tools.docs.pages import DOCS, ROOT, Block, anchors, blocks, links, pages

PAGES = pages()


def problems(page: Path) -> list[str]:
    """Every link of the page that leads nowhere."""
    found = []
    for line, target in links(page):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists():
            found.append(f"line {line}: {target}")
        elif anchor and anchor not in anchors(file):
            found.append(f"line {line}: no heading #{anchor} in {file.name}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_the_page_leads_somewhere(page: Path) -> None:
    assert problems(page) == []


def test_a_broken_link_and_an_unclosed_block_are_reported(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One\n\n[a](page.md#one) [b](page.md#two) [c](none.md) `[d](none.md)`\n```\n[e](none.md)\n```\n")
    assert problems(page) == ["line 3: no heading #two in page.md", "line 3: none.md"]
    page.write_text("```sh\nls\n")
    with pytest.raises(ValueError, match="no closing fence"):
        list(blocks(page))


def test_blocks_have_language_text_and_the_reason_for_not_being_run(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("text\n<!-- not run: needs a rig -->\n```sh\nls\n```\n\n- x\n\n    ```yaml\n    a: 1\n    ```\n")
    first, second = blocks(page)
    assert first == Block(page, 3, "sh", "ls", "<!-- not run: needs a rig -->")
    assert first.reason == "needs a rig"
    assert (second.line, second.language, second.text, second.reason) == (9, "yaml", "a: 1", "")


def test_every_image_of_the_documentation_is_used() -> None:
    used = {(page.parent / target).resolve() for page in PAGES for _, target in links(page)}
    assert [str(path) for path in sorted((DOCS / "images").iterdir()) if path not in used] == []


def test_the_tables_of_the_expected_noise_are_current() -> None:
    text = noise.PAGE.read_text(encoding="utf-8")
    assert text.count("<!-- computed: ") == len(noise.tables())
    assert noise.with_tables(text) == text, "run python -m tools.docs.noise"


def test_the_expected_noise_is_proportional_to_period_and_distance() -> None:
    assert noise.sigma_mm(200, 3) == pytest.approx(0.5 * noise.sigma_mm(400, 3))
    assert noise.sigma_mm(400, 4) == pytest.approx(2 * noise.sigma_mm(400, 2))
    assert noise.phase_noise(noise.GREY) > 2 * noise.phase_noise(noise.WHITE)


def test_the_expected_noise_is_that_of_the_pipeline() -> None:
    layout, optics = RigLayout().scaled(0.25), Optics()
    pattern = layout.pattern()
    pair = render_pair(layout, build("plane"), pattern, optics)
    cloud = Reconstructor(layout.calibration_for(optics), pattern, layout.volume()).reconstruct(pair.left, pair.right)
    field = layout.camera_size[0] * layout.standoff_mm / layout.focal_px
    expected = 4 * noise.sigma_mm(field, layout.standoff_mm / layout.baseline_mm)  # a quarter of the periods
    assert np.nanmedian(cloud.sigma_mm) == pytest.approx(expected, rel=0.1)


def test_the_reference_has_every_command_and_setting() -> None:
    from daemon.cli.command_table import COMMANDS

    commands, settings = reference.commands(), reference.settings()
    assert all(f"## fringed {name}\n" in commands for name in COMMANDS)
    assert "### fringed calibrate board\n" in commands and "`--paper STR`" in commands
    assert "| `pipeline.settings.min_modulation` | `5.0` | number 0.5 to 100, counts | yes |" in settings
    page = "a\n<!-- generated: settings -->\nb"
    assert reference.with_parts(page) == f"a\n{settings}\nb"
    with pytest.raises(KeyError):
        reference.with_parts("<!-- generated: nothing -->")


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    process = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout + process.stderr
    commands = (tmp_path / "site" / "reference" / "commands.html").read_text(encoding="utf-8")
    assert "generated:" not in commands and "fringed doctor" in commands
    assert "ReceivedCloud" in (tmp_path / "site" / "reference" / "python.html").read_text(encoding="utf-8")
