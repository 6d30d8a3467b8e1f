"""What the daemon tells its gate, and what the gate tells back: one JSON object a line."""

from __future__ import annotations

import msgspec


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What to guard.

    Args:
        keys: the directory of keys. stream, control: addresses to bind, either may be empty.
        source, target: the daemon's own stream and control endpoints, on this machine.
        roles: needed for each method of control, view or operate.
        connections: at most so many at a time. memory_mb: of the gate; beyond it everybody is cut off.
    """

    keys: str
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
        keys: how many are allowed. problem: what is wrong with the files of keys.
        refused: how often, by service and reason. accepted: connections that were let in.
        sent, skipped: messages of the stream; requests: passed on. cut: how often everybody was cut off, by reason.
        last: the newest refusal, in words.
    """

    stream: list[str] = []
    control: list[str] = []
    failed: str = ""
    keys: int = 0
    problem: str = ""
    refused: dict[str, int] = {}
    accepted: int = 0
    connections: int = 0
    sent: int = 0
    skipped: int = 0
    requests: int = 0
    cut: dict[str, int] = {}
    memory_mb: int = 0
    last: str = ""
