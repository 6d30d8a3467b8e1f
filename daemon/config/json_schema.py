"""The JSON Schema of rig.yaml, for editors; ``python -m daemon.config.json_schema`` writes it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from daemon.config.rig_config import RigConfig

COMMITTED = Path(__file__).parents[2] / "schema" / "fringed.schema.json"


def schema() -> dict[str, Any]:
    """Return the schema; no default in it depends on this machine."""
    title = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return title | RigConfig.model_json_schema()


def text() -> str:
    """Return the schema as text, as committed in the repository."""
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    COMMITTED.write_text(text(), encoding="utf-8")
