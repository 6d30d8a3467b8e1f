"""The key files, read again when they change; the gate gets their content and needs no files itself."""

from __future__ import annotations

import logging

from daemon.common.errors import DaemonError
from daemon.keys.key_store import KeyStore
from daemon.remote_access.gate_messages import Keyring
from fringed.errors import FringedError

log = logging.getLogger("fringed.gate")


class KeyWatch:
    """The keys as in the files; a file with a mistake changes nothing and is reported as ``problem``.

    Raises:
        DaemonError: the keys cannot be used at the start.
    """

    def __init__(self, store: KeyStore) -> None:
        self._store = store
        self._signature = store.signature()
        self.keyring = self._read()
        self.problem = ""

    def changed(self) -> bool:
        """Read the files if they have changed; return whether ``keyring`` is another one than before."""
        signature = self._store.signature()
        if signature == self._signature:
            return False
        self._signature = signature
        try:
            fresh = self._read()
        except (DaemonError, FringedError, OSError) as error:
            self.problem = f"the previous keys stay in use: {error}"
            log.error("%s", self.problem)
            return False
        self.problem = ""
        before, self.keyring = self.keyring, fresh
        return fresh != before

    def _read(self) -> Keyring:
        return Keyring(server=self._store.server(), entries=list(self._store.authorized().entries.values()))
