"""Messages between the daemon and its gate process: one JSON object a line."""

from __future__ import annotations

import msgspec

from daemon.keys.authorized_keys import AuthorizedKeys, Entry
from fringed.keys import Key


class Keyring(msgspec.Struct, frozen=True):
    """The daemon's own pair and the authorised keys."""

    server: Key
    entries: list[Entry]

    def authorized(self) -> AuthorizedKeys:
        """Return the authorised keys by public key."""
        return AuthorizedKeys({entry.public: entry for entry in self.entries})


class GateConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of the gate, the daemon's first message; each later one is a Keyring that replaces the last.

    Args:
        stream, control: addresses to bind, either may be empty.
        source, target: the daemon's own stream and control endpoints, on this machine.
        roles: needed for each method of control, view or operate.
        connections: at most, at a time. memory_mb: limit of the gate, beyond which all clients are disconnected.
    """

    stream: list[str]
    control: list[str]
    source: str
    target: str
    roles: dict[str, str]
    connections: int = 64
    memory_mb: int = 1024


class GateStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Status of the gate, sent once a second.

    Args:
        stream, control: addresses with their real ports. failed: why it cannot start.
        refused: count by service and reason. accepted: connections since the start, connections: now.
        sent, skipped: messages of the stream; requests: forwarded. cut: disconnections of all clients, by reason.
        last: description of the newest refusal.
    """

    stream: list[str] = []
    control: list[str] = []
    failed: str = ""
    refused: dict[str, int] = {}
    accepted: int = 0
    connections: int = 0
    sent: int = 0
    skipped: int = 0
    requests: int = 0
    cut: dict[str, int] = {}
    memory_mb: int = 0
    last: str = ""
