"""The list of authorised keys: one line each, with its roles on the stream and on control."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from daemon.common.errors import DaemonError
from fringed.keys import is_name, is_z85

Role = Literal["none", "view", "operate"]
Service = Literal["stream", "control"]

MAX_BYTES = 64 * 1024
MAX_ENTRIES = 256
HEADER = "# name stream(none|view) control(none|view|operate) public-key; edit it with: fringed keys allow, revoke\n"
_ROLES: Mapping[Service, tuple[Role, ...]] = {"stream": ("none", "view"), "control": ("none", "view", "operate")}


@dataclass(frozen=True, slots=True)
class Entry:
    """A key and its roles."""

    name: str
    stream: Role
    control: Role
    public: str

    def line(self) -> str:
        """Return the entry's line of the file."""
        return f"{self.name} {self.stream} {self.control} {self.public}\n"


@dataclass(frozen=True, slots=True)
class AuthorizedKeys:
    """Every authorised key, by its public half."""

    entries: Mapping[str, Entry] = field(default_factory=dict)

    def role(self, service: Service, public: str) -> Role:
        """Return the role of a key, "none" for one that is not in the list."""
        entry = self.entries.get(public)
        if entry is None:
            return "none"
        return entry.stream if service == "stream" else entry.control

    def lost(self, service: Service, newer: AuthorizedKeys) -> bool:
        """Return whether a key that may connect to a service may not with a newer list."""
        had = (public for public in self.entries if self.role(service, public) != "none")
        return any(newer.role(service, public) == "none" for public in had)


def parse(text: str, where: str) -> AuthorizedKeys:
    """Parse a list.

    Raises:
        DaemonError: with file:line of the first mistake; a list with a mistake is never used in part.
    """
    entries: dict[str, Entry] = {}
    names: dict[str, int] = {}
    if len(text.encode()) > MAX_BYTES:
        raise DaemonError(f"{where}: more than {MAX_BYTES} bytes")
    for number, entry in _entries(text, where):
        if entry.name in names or entry.public in entries:
            first = names.get(entry.name) or names[entries[entry.public].name]
            raise DaemonError(f"{where}:{number}: this name or key is already in line {first}")
        names[entry.name] = number
        entries[entry.public] = entry
    if len(entries) > MAX_ENTRIES:
        raise DaemonError(f"{where}: {len(entries)} keys, at most {MAX_ENTRIES} are accepted")
    return AuthorizedKeys(entries)


def _entries(text: str, where: str) -> Iterator[tuple[int, Entry]]:
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                yield number, _entry(line.split())
            except ValueError as error:
                raise DaemonError(f"{where}:{number}: {error}") from None


def _entry(fields: list[str]) -> Entry:
    if len(fields) != 4:
        raise ValueError(f"{len(fields)} fields, expected four: name, stream's role, control's role, public key")
    name, stream, control, public = fields
    if not is_name(name):
        raise ValueError("the name has other characters than letters, digits, '.', '_' and '-', or more than 64")
    if not is_z85(public):
        raise ValueError(f"the key of {name} is not 40 characters of Z85")
    return Entry(name, role("stream", stream), role("control", control), public)


def role(service: Service, text: str) -> Role:
    """Return a role by its name.

    Raises:
        ValueError: the service has no such role.
    """
    for known in _ROLES[service]:
        if text == known:
            return known
    raise ValueError(f"{text!r:.40} is no role on {service}; there are {', '.join(_ROLES[service])}")


def with_entry(text: str, entry: Entry) -> str:
    """Return a file's text with an entry added, or with the line of that name replaced; comments stay."""
    return "".join(_other_lines(text or HEADER, entry.name)) + entry.line()


def without(text: str, name: str) -> str:
    """Return a file's text without the entry of a name; comments stay."""
    return "".join(_other_lines(text, name))


def _other_lines(text: str, name: str) -> Iterator[str]:
    for line in text.splitlines():
        if line.split()[:1] != [name]:
            yield line + "\n"
