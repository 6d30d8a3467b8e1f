"""Rerun without its usage reports.

Rerun has no environment variable for this, only a file in the user's configuration directory. That file belongs to the
user, so this process and its viewers use another configuration directory, where the reports are off.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from daemon.common.files import write_atomically


def rerun() -> Any:
    """Import the module ``rerun`` after its reports are switched off; the viewer imports it only here."""
    _switch_off()
    import rerun as module

    return module


def _switch_off() -> None:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fringed"
    home = cache / "viewer-config"
    file = home / "rerun" / "analytics.json"
    settings = {
        "analytics_enabled": False,
        "analytics_id": "off",
        "metadata": {},
        "config_file_path": str(file),
        "data_dir_path": str(cache / "viewer-data"),
    }
    data = json.dumps(settings).encode()
    if not file.is_file() or file.read_bytes() != data:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomically(file, data)
    os.environ["XDG_CONFIG_HOME"] = str(home)
