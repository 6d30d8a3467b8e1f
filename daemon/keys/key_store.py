"""The directory of keys: the daemon's own pair and the list of authorised keys."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daemon.common.errors import DaemonError
from daemon.common.files import write_atomically
from daemon.keys import authorized_keys
from daemon.keys.authorized_keys import AuthorizedKeys, Entry
from fringed.errors import KeyFileError
from fringed.keys import Key, new_key, read_key

SERVER_KEY, SERVER_PUBLIC, LIST = "server.key", "server.pub", "allowed"
SYSTEM_DIR = Path("/etc/fringed/keys")


def default_dir() -> Path:
    """Return the machine's directory where it exists or can be created; else the user's."""
    if SYSTEM_DIR.is_dir() or os.geteuid() == 0:
        return SYSTEM_DIR
    base = os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()
    return Path(base) / "fringed" / "keys"


class KeyStore:
    """Keys in a directory; changes replace whole files, under a lock.

    A directory that only its group may enter (0750, the service's) shares its secrets with the group.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    @property
    def public(self) -> Path:
        """File of the public server key, for clients."""
        return self.directory / SERVER_PUBLIC

    def server(self) -> Key:
        """Return the daemon's own pair.

        Raises:
            DaemonError: it is missing or cannot be used.
        """
        path = self.directory / SERVER_KEY
        try:
            return read_key(path, secret=True)
        except KeyFileError as error:
            hint = "" if path.exists() else f"; make it with: fringed keys server --dir {self.directory}"
            raise DaemonError(f"{error}{hint}") from error

    def authorized(self) -> AuthorizedKeys:
        """Return the authorised keys, none while there is no list.

        Raises:
            DaemonError: a list with a mistake, with file:line, or one that others can change.
        """
        path = self.directory / LIST
        text = self._text()
        if text and path.stat().st_mode & (stat.S_IWOTH | stat.S_IWGRP):
            raise DaemonError(f"{path}: others can change it and so authorise any key; chmod go-w {path}")
        return authorized_keys.parse(text, str(path))

    def readable(self) -> bool:
        """Return whether this user may read the files; missing ones count as readable."""
        paths = (self.directory, self.directory / SERVER_KEY, self.directory / LIST)
        try:
            return all(os.access(path, os.R_OK) or not path.exists() for path in paths)
        except PermissionError:
            return False

    def signature(self) -> tuple[tuple[int, int, int], ...]:
        """Return a value that changes whenever one of the files does; uses no descriptor."""
        signatures = []
        for name in (SERVER_KEY, LIST):
            try:
                status = (self.directory / name).stat()
                signatures.append((status.st_ino, status.st_ctime_ns, status.st_size))
            except OSError:
                signatures.append((0, 0, 0))
        return tuple(signatures)

    def make_server(self) -> Key:
        """Return the daemon's own pair, created if it does not exist yet."""
        with self._changing():
            if (self.directory / SERVER_KEY).exists():
                key = self.server()
            else:
                key = new_key("server")
                self._write(SERVER_KEY, key.text(secret=True))
            if not self.public.exists():
                write_key(self.public, key, secret=False)
            return key

    def allow(self, entry: Entry) -> None:
        """Authorise a key; one of the same name is replaced, the old list stays after an error."""
        with self._changing():
            text = authorized_keys.with_entry(self._text(), entry)
            authorized_keys.parse(text, str(self.directory / LIST))
            self._write(LIST, text)

    def revoke(self, name: str) -> Entry:
        """Remove the key of a name from the list."""
        with self._changing():
            entry = next((one for one in self.authorized().entries.values() if one.name == name), None)
            if entry is None:
                raise DaemonError(f"no key is named {name!r:.80} in {self.directory / LIST}; see: fringed keys list")
            self._write(LIST, authorized_keys.without(self._text(), name))
            return entry

    def _text(self) -> str:
        path = self.directory / LIST
        try:
            with path.open(encoding="utf-8") as file:
                return file.read(authorized_keys.MAX_BYTES + 1)
        except FileNotFoundError:
            return ""
        except OSError as error:
            raise DaemonError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise DaemonError(f"{path}: cannot be read: not text") from error

    def _write(self, name: str, text: str) -> None:
        directory = self.directory.stat()
        shared = directory.st_mode & (stat.S_IXGRP | stat.S_IXOTH) == stat.S_IXGRP
        _write(self.directory / name, text, 0o640 if shared else 0o600)
        if shared:
            os.chown(self.directory / name, -1, directory.st_gid)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        try:
            self.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            handle = os.open(self.directory, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise DaemonError(f"{self.directory}: cannot be used for keys: {error.strerror}") from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        except PermissionError as error:
            raise DaemonError(f"{self.directory}: {error.strerror}; run it as the owner of the directory") from error
        finally:
            os.close(handle)


def write_key(path: Path, key: Key, *, secret: bool) -> None:
    """Write a key; with its secret, only the owner may read the file."""
    _write(path, key.text(secret=secret), 0o600 if secret else 0o644)


def _write(path: Path, text: str, mode: int) -> None:
    before = os.umask(0o777 & ~mode)
    try:
        write_atomically(path, text.encode())
        path.chmod(mode)
    finally:
        os.umask(before)
