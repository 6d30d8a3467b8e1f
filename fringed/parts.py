"""Parts of a cloud: their names and types, and the topic by which a subscriber asks for some of them."""

from __future__ import annotations

from collections.abc import Iterable

from fringed.errors import ArgumentError, FringedError

PARTS: dict[str, tuple[str, tuple[int, ...]]] = {
    "xyz": ("<f4", (3,)),
    "gray": ("|u1", ()),
    "sigma": ("<f4", ()),
    "rgb": ("|u1", (3,)),
    "normals": ("<f4", (3,)),
    "interpolated": ("|u1", ()),
}
"""Type of each part and its shape after (H, W), in the order in which messages carry them."""

BASIC = ("xyz", "gray", "sigma")
"""Parts that every cloud has."""
COMPUTED = frozenset(("rgb", "normals"))
"""Parts that are computed only if a subscriber or the configuration asks for them."""
_PREFIX, _END = "cloud/parts/", "/"
_FULL, _SHARED = "cloud/full", "cloud/shared/"


def parse_parts(names: str | Iterable[str], where: str = "parts") -> tuple[str, ...]:
    """Names of parts, checked, in the order of messages.

    Args:
        names: a list, or text with commas; where: what gives them, for errors.

    Raises:
        ArgumentError: there is none, one is not known or named twice, or ``xyz`` is missing.
    """
    given = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    choice = f"choose from {', '.join(PARTS)}"
    if not any(given):
        raise ArgumentError(f"{where} names no part; {choice}")
    for name in given:
        if name not in PARTS:
            raise ArgumentError(f"{where}: there is no part {name!r:.40}; {choice}")
        if given.count(name) > 1:
            raise ArgumentError(f"{where} names the part {name!r} {given.count(name)} times, limit 1; name each once")
    if "xyz" not in given:
        raise ArgumentError(f"{where} is {','.join(given)!r} without 'xyz'; every cloud has its points: add xyz")
    return tuple(name for name in PARTS if name in given)


def topic_of(parts: Iterable[str]) -> str:
    """The topic of clouds with these parts: ``cloud/parts/xyz,rgb/``."""
    return f"{_PREFIX}{','.join(parse_parts(parts))}{_END}"


def parts_of(topic: str) -> tuple[str, ...] | None:
    """The parts that a topic asks for; None for another topic, and for one that :func:`topic_of` does not give."""
    if not (topic.startswith(_PREFIX) and topic.endswith(_END)):
        return None
    try:
        parts = parse_parts(topic[len(_PREFIX) : -len(_END)])
    except FringedError:
        return None
    return parts if topic_of(parts) == topic else None


def shared_topic(topic: str) -> str:
    """The topic that has the clouds of ``cloud/full`` or ``cloud/parts/NAMES/`` in shared memory.

    Raises:
        ArgumentError: a topic whose clouds are not in shared memory.
    """
    if topic == _FULL:
        return f"{_SHARED}full{_END}"
    if parts_of(topic) is None:
        raise ArgumentError(f"topic {topic!r} is not in shared memory; choose {_FULL} or name parts")
    return _SHARED + topic.removeprefix(_PREFIX)


def copied_topic(topic: str) -> str | None:
    """The topic that carries the clouds of a :func:`shared_topic` itself; None for any other topic."""
    if topic == shared_topic(_FULL):
        return _FULL
    named = _PREFIX + topic.removeprefix(_SHARED)
    return named if topic.startswith(_SHARED) and parts_of(named) is not None else None
