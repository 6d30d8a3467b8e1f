"""Keys for a daemon on another machine, which authenticate client and daemon (CURVE of ZeroMQ).

A key file has a line for each value, ``name: text``; lines that begin with ``#`` are comments. ``*.pub`` holds the
public key, ``*.key`` the secret as well.
"""

from __future__ import annotations

import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq
from zmq.utils import z85

from fringed.errors import ArgumentError, KeyFileError

MAX_BYTES = 4096
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_FIELDS = ("name", "public", "secret")


@dataclass(frozen=True, slots=True)
class Key:
    """One key: ``public`` and ``secret`` are 40 characters of Z85; ``secret`` is None for a public key."""

    name: str
    public: str
    secret: str | None = None

    def text(self, *, secret: bool) -> str:
        """Return the contents of a key file."""
        comment = "Secret: its owner can connect." if secret else "Not secret: give it to the other side."
        lines = [f"# A key of fringed. {comment}", f"name: {self.name}", f"public: {self.public}"]
        return "\n".join([*lines, *([f"secret: {self.secret}"] if secret else [])]) + "\n"


@dataclass(frozen=True, slots=True)
class Keys:
    """Keys of a client: its own pair and the public key of the daemon."""

    public: str
    secret: str
    server: str

    @classmethod
    def load(cls, key: str | Path, server_key: str | Path) -> Keys:
        """Load the keys of two files.

        Args:
            key: ``NAME.key`` from ``fringed keys new NAME``; server_key: ``server.pub`` of the daemon.

        Raises:
            KeyFileError: a file is not a key, or others can read the secret.
        """
        own, server = read_key(Path(key), secret=True), read_key(Path(server_key))
        return cls(own.public, str(own.secret), server.public)

    def apply(self, socket: zmq.Socket[Any]) -> None:
        """Set the keys of a socket before it connects."""
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.server.encode())
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.public.encode())
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.secret.encode())


def checked_keys(keys: object) -> Keys | None:
    """Return the keys of a client, or None.

    Raises:
        ArgumentError: something else, such as the path of a key file.
    """
    if keys is None or isinstance(keys, Keys):
        return keys
    raise ArgumentError(
        f"keys is of type {type(keys).__name__}, expected Keys: Keys.load('laptop.key', 'server.pub') reads both files"
    )


def loaded_keys(key: Keys | str | Path | None, server_key: str | Path | None) -> Keys | None:
    """Return the keys that two arguments name.

    Args:
        key: file of the own key, or keys that are loaded already; server_key: file of the daemon's public key.

    Raises:
        ArgumentError: one without the other, or another type; KeyFileError: a file is not a key.
    """
    if isinstance(key, str | Path):
        if not isinstance(server_key, str | Path):
            raise ArgumentError(
                f"server_key is {server_key!r}, expected the file of the daemon's public key (server.pub), which "
                f"belongs to key {str(key)!r}"
            )
        return Keys.load(key, server_key)
    if key is not None and not isinstance(key, Keys):
        raise ArgumentError(f"key is of type {type(key).__name__}, expected the path of NAME.key, or Keys")
    if server_key is not None:
        raise ArgumentError(f"server_key {str(server_key)!r} is without key, the path of your own NAME.key")
    return key


def new_key(name: str) -> Key:
    """Create a new pair."""
    if not is_name(name):
        raise KeyFileError(f"{name!r:.80} is not a name of a key: letters, digits, '.', '_' and '-', at most 64")
    public, secret = zmq.curve_keypair()
    return Key(name, public.decode(), secret.decode())


def is_name(text: str) -> bool:
    """Return whether a key can have this name."""
    return bool(_NAME.fullmatch(text))


def is_z85(text: str) -> bool:
    """Return whether a text is the canonical Z85 encoding of 32 bytes."""
    if len(text) != 40 or not text.isascii():
        return False
    try:
        data: bytes = z85.decode(text.encode())
        return z85.encode(data) == text.encode()
    except Exception:  # the decoder raises several types for invalid text
        return False


def read_key(path: Path, *, secret: bool = False) -> Key:
    """Read the key of a file; ``secret``: it must hold the secret, unreadable for others.

    Raises:
        KeyFileError: with file, line and next step.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_BYTES:
            raise KeyFileError(f"{path}: not a key file (a plain file of at most {MAX_BYTES} bytes)")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise KeyFileError(f"{path}: cannot be read: not text") from error
    key = parse_key(text, str(path))
    if key.secret is not None and status.st_mode & (stat.S_IRWXO | stat.S_IWGRP):
        raise KeyFileError(f"{path}: others can read or change this secret; chmod 600 {path}, better create a new key")
    if secret and key.secret is None:
        raise KeyFileError(f"{path}: no secret in it; name the file that ends with .key")
    return key


def parse_key(text: str, where: str) -> Key:
    """Parse the key of a text; messages begin with ``where``."""
    values: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        field, colon, value = (part.strip() for part in line.partition(":"))
        if not colon or field not in _FIELDS:
            raise KeyFileError(f"{where}:{number}: expected one of {', '.join(_FIELDS)} with a colon")
        if field in values:
            raise KeyFileError(f"{where}:{number}: {field} is defined twice")
        if not (is_name(value) if field == "name" else is_z85(value)):
            raise KeyFileError(f"{where}:{number}: {_expected(field)}")
        values[field] = value
    for field in ("name", "public"):
        if field not in values:
            raise KeyFileError(f"{where}: {field} is missing")
    key = Key(values["name"], values["public"], values.get("secret"))
    if key.secret is not None and zmq.curve_public(key.secret.encode()).decode() != key.public:
        raise KeyFileError(f"{where}: public and secret do not match; create a new key")
    return key


def _expected(field: str) -> str:
    if field == "name":
        return "a name has letters, digits, '.', '_' and '-', at most 64"
    return f"the {field} key is not 40 characters of Z85"  # the value itself may be a secret
