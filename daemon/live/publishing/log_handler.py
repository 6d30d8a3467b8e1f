"""Log lines of the daemon, passed to the stream."""

from __future__ import annotations

import logging
from collections.abc import Callable


class StreamHandler(logging.Handler):
    """Passes lines of INFO and above to ``publish(t_ns, level, logger, text)``, which must not block or log."""

    def __init__(self, publish: Callable[[int, str, str, str], None]) -> None:
        super().__init__(logging.INFO)
        self._publish = publish

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one line."""
        try:
            self._publish(round(record.created * 1e9), record.levelname.lower(), record.name, record.getMessage())
        except Exception:
            self.handleError(record)
