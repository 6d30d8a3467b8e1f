"""Reload: rig.yaml and the files that it names are read again and applied live, as a whole or not at all."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daemon.common.errors import DaemonError
from daemon.config import load_rig
from daemon.control.settings.change import Changer

log = logging.getLogger("fringed.reload")


class Reloader:
    """Reads the rig file again, for ``fringed reload`` and SIGHUP.

    Args:
        path: of rig.yaml, None for a daemon that was not started from a file.
        refusal: returns why a reload is not possible now, empty when it is.
    """

    def __init__(self, changer: Changer, path: Path | None, refusal: Callable[[], str]) -> None:
        self._changer, self._path, self._refusal = changer, path, refusal

    def reload(self) -> dict[str, Any]:
        """Apply the content of the files; ``changed`` names the settings.

        Settings that were changed live return to their value in the file, or to their default.

        Raises:
            ConfigError: a file with mistakes; NeedsRestartError: a change needs a restart; DaemonError, PipelineError,
                OSError: refused. Nothing was changed then.
        """
        try:
            changed = self._reload()
        except Exception as error:
            log.warning("not reloaded, nothing was changed: %s", error)
            raise
        log.info("reloaded: %s", ", ".join(changed) or "nothing has changed")
        return {"changed": changed, "restart": []}

    def _reload(self) -> list[str]:
        if self._path is None:
            raise DaemonError("this daemon was not started from a file")
        refusal = self._refusal()
        if refusal:
            raise DaemonError(f"no reload now, nothing was changed: {refusal}")
        return self._changer.apply(load_rig(self._path))
