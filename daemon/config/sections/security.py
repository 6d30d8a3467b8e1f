"""Section ``security`` of rig.yaml, and the check of its keys."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from daemon.config.sections.section import Section
from daemon.config.yaml_source import KeyPath, read_yaml


class Security(Section):
    """Access from other machines."""

    keys: Annotated[str | None, Field(min_length=1, description="Directory of the keys; see `fringed keys`.")] = None
    connections: Annotated[int, Field(ge=1, le=1000, description="From other machines, at a time.")] = 64


def key_problems(data: dict[str, Any], base_dir: Path) -> Iterator[tuple[KeyPath, str]]:
    """Yield problems of the configured keys; files that only the service's user may read are not checked."""
    from daemon.common.errors import DaemonError
    from daemon.keys.key_store import KeyStore

    directory = _configured(data)
    if directory is None:
        return
    store = KeyStore(base_dir / directory)
    if not store.readable():
        return
    for read in (store.server, store.authorized):
        try:
            read()
        except DaemonError as error:
            yield ("security", "keys"), f"security.keys: {error}"


def keys_dir(rig: Path) -> Path | None:
    """Return ``security.keys`` of a rig file that may have other mistakes: the keys are created before it is valid."""
    directory = _configured(read_yaml(rig.read_text(encoding="utf-8")).data)
    return None if directory is None else rig.parent / directory


def _configured(data: Any) -> Path | None:
    security = data.get("security") if isinstance(data, dict) else None
    directory = security.get("keys") if isinstance(security, dict) else None
    return Path(directory).expanduser() if isinstance(directory, str) and directory else None
