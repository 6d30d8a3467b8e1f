"""Changes of a running daemon: all that can fail comes first, then everything changes at once between two pairs."""

from __future__ import annotations

import threading
from collections.abc import Collection
from pathlib import Path
from typing import Any

from daemon.common.errors import ConfigError, DaemonError
from daemon.config.rig_config import RigConfig
from daemon.control.settings.changed_files import changed_files, check_fit, needs_restart, read_again
from daemon.control.settings.flatten import differences, leaves, settings_of, with_value
from daemon.control.settings.live_settings import BY_FILE, FILES, is_live
from daemon.live.items import Changeable
from daemon.live.service import Service


class NeedsRestartError(DaemonError):
    """Changes that a running daemon cannot apply; nothing was changed.

    Args:
        restart: paths that need a restart; live: those that would not.
    """

    def __init__(self, restart: list[str], live: list[str]) -> None:
        self.restart, self.live = restart, live
        also = f" ({', '.join(live)} would not)" if live else ""
        need = "needs" if len(restart) == 1 else "need"
        super().__init__(f"nothing was changed: {', '.join(restart)} {need} a restart{also}")


class SettingError(DaemonError):
    """An unknown setting or an invalid value; ``path`` names the setting."""

    def __init__(self, path: str, message: str) -> None:
        self.path = path
        super().__init__(message)


class Changer:
    """Applies changes of settings, one at a time.

    Args:
        service: to change; base_dir: base of the relative paths of its rig.yaml.
    """

    def __init__(self, service: Service, base_dir: Path) -> None:
        self._service, self._base_dir = service, base_dir
        self._lock = threading.Lock()

    def set(self, path: str, value: Any) -> Any:
        """Change one setting; return its new value.

        Raises:
            SettingError: an unknown path or invalid value; NeedsRestartError; DaemonError, PipelineError: refused.
        """
        with self._lock:
            service = self._service
            if path not in leaves(service.config, service.settings):
                raise SettingError(path, f"there is no setting {path!r:.100}; `get` without a path lists them all")
            if not is_live(path):
                raise SettingError(
                    path,
                    f"{path} cannot be set live; change it in rig.yaml and restart the daemon. Nothing was changed",
                )
            if path in BY_FILE or (path in FILES and isinstance(value, str)):
                raise SettingError(path, f"{path} names a path on the disk; change it in rig.yaml and reload")
            try:
                config = with_value(service.config, service.settings, path, value, self._base_dir)
            except (ConfigError, ValueError, TypeError, RecursionError) as error:
                raise SettingError(path, str(error)) from error
            self._apply(config, files=[path])
            return leaves(service.config, service.settings)[path]

    def apply(self, config: RigConfig) -> list[str]:
        """Change to a whole configuration and the present content of its files; return the changed paths.

        Raises:
            NeedsRestartError: a change needs a restart; DaemonError, PipelineError, OSError: refused.
        """
        with self._lock:
            return self._apply(config, files=FILES)

    def _apply(self, config: RigConfig, *, files: Collection[str]) -> list[str]:
        service = self._service
        settings = settings_of(config)
        rig = read_again(service.rig, config, self._base_dir, names=files)
        paths = differences((service.config, service.settings), (config, settings))
        changed = list(dict.fromkeys((*paths, *changed_files(service.rig, rig))))
        lost = [p for p in FILES if getattr(config, p) is None and getattr(service.config, p) is not None]
        restart = [p for p in changed if not is_live(p) or p in lost or p in needs_restart(service.rig, rig)]
        if restart:
            raise NeedsRestartError(restart, [p for p in changed if p not in restart])
        if not changed:
            return []
        if rig is not service.rig:
            check_fit(rig, {side: camera.status for side, camera in service.cameras.items()})
        sinks = [sink for sink in service.router.sinks.values() if isinstance(sink, Changeable)]
        service.change(config, rig, settings, [sink.change(config, rig) for sink in sinks])
        return changed
