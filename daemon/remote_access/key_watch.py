"""The files of keys, read again when they change; the gate gets what they say, and needs no files itself."""

from __future__ import annotations

import logging

from daemon.common.errors import DaemonError
from daemon.keys.key_store import KeyStore
from daemon.remote_access.gate_messages import Keyring
from fringed.errors import FringedError

log = logging.getLogger("fringed.gate")


class KeyWatch:
    """Keys as the files are; a mistake in them changes nothing and is told as ``problem``.

    Raises:
        DaemonError: keys that cannot be used from the start.
    """

    def __init__(self, store: KeyStore) -> None:
        self._store = store
        self._seen = store.signature()
        self.keyring = self._read()
        self.problem = ""

    def changed(self) -> bool:
        """Look at the files; whether ``keyring`` is another one than before."""
        seen = self._store.signature()
        if seen == self._seen:
            return False
        self._seen = seen
        try:
            fresh = self._read()
        except (DaemonError, FringedError, OSError) as error:
            self.problem = f"the keys are those of before: {error}"
            log.error("%s", self.problem)
            return False
        self.problem = ""
        before, self.keyring = self.keyring, fresh
        return fresh != before

    def _read(self) -> Keyring:
        return Keyring(server=self._store.server(), entries=list(self._store.allowed().entries.values()))
