"""What the daemon tells its gate, and what the gate tells back: one JSON object a line."""

from __future__ import annotations

import msgspec

from daemon.keys.authorized_keys import Allowed, Entry
from fringed.keys import Key


class Keyring(msgspec.Struct, frozen=True):
    """The daemon's own pair, and those that may connect."""

    server: Key
    entries: list[Entry]

    def allowed(self) -> Allowed:
        """The list by key."""
        return Allowed({entry.public: entry for entry in self.entries})


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What to guard, the first word of the daemon; each later one is a Keyring that replaces the one before.

    Args:
        stream, control: addresses to bind, either may be empty.
        source, target: the daemon's own stream and control endpoints, on this machine.
        roles: needed for each method of control, view or operate.
        connections: at most so many at a time. memory_mb: of the gate; beyond it everybody is cut off.
    """

    stream: list[str]
    control: list[str]
    source: str
    target: str
    roles: dict[str, str]
    connections: int = 64
    memory_mb: int = 1024


class Told(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A word of the gate.

    Args:
        stream, control: addresses with their real ports. failed: why it cannot begin.
        refused: how often, by service and reason. accepted: connections that were let in, connections: now.
        sent, skipped: messages of the stream; requests: passed on. cut: how often everybody was cut off, by reason.
        last: the newest refusal, in words.
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
