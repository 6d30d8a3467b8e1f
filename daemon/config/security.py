"""Section ``security`` of rig.yaml, and what it has to do with the addresses of stream and control."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from daemon.config.section import Section
from daemon.config.yaml_source import Path_, read_yaml


class Security(Section):
    """Who may connect from other machines."""

    keys: Annotated[str | None, Field(min_length=1, description="Directory of the keys; see `fringed keys`.")] = None
    connections: Annotated[int, Field(ge=1, le=1000, description="From other machines, at a time.")] = 64


def key_problems(data: dict[str, Any], base_dir: Path) -> Iterator[tuple[Path_, str]]:
    """Keys that are named and cannot be used; files that only the service's user may read are left to it."""
    from daemon.common.errors import DaemonError
    from daemon.keys.key_store import KeyStore

    directory = _named(data)
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
    """``security.keys`` of a rig file, whatever else is wrong with it: before the first key is made, something is."""
    named = _named(read_yaml(rig.read_text(encoding="utf-8")).data)
    return None if named is None else rig.parent / named


def _named(data: Any) -> Path | None:
    security = data.get("security") if isinstance(data, dict) else None
    named = security.get("keys") if isinstance(security, dict) else None
    return Path(named).expanduser() if isinstance(named, str) and named else None
