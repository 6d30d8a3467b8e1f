"""Hooks of mkdocs: generated parts of the reference."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.docs.reference import with_parts


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the marks of generated parts."""
    return with_parts(markdown)
