"""Authentication of CURVE keys for ZeroMQ (ZAP, RFC 27)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

from zmq.utils import z85

from daemon.common.counters import Counters
from daemon.keys.authorized_keys import AuthorizedKeys, Service

_OK, _NOT_NOW, _BAD = (b"200", b"allowed"), (b"300", b"not allowed"), (b"400", b"not a request")
# 300, not 400: after a 400 a client gives up for good, after a 300 it retries and connects once it is authorised.


class ZapHandler:
    """Replies to ZAP requests from the present list of keys.

    Args:
        authorized: returns the list; refused: counts by service and reason.
    """

    def __init__(self, authorized: Callable[[], AuthorizedKeys], refused: Counters) -> None:
        self._authorized, self._refused = authorized, refused
        self.last = ""

    def reply(self, frames: list[bytes]) -> list[bytes]:
        """Return the reply to the frames of a request after its envelope.

        The User-Id of a connection is its public key, so that its role can be looked up at each message.
        """
        request = frames[1] if len(frames) > 1 else b""
        if len(frames) != 7 or frames[0] != b"1.0" or frames[5] != b"CURVE" or len(frames[6]) != 32:
            self._refused.add("request_odd")
            return [b"1.0", request, *_BAD, b"", b""]
        domain, address = frames[2], frames[3]
        public = z85.encode(frames[6])
        service = _service(domain)
        if service is not None and self._authorized().role(service, public.decode()) != "none":
            return [b"1.0", request, *_OK, public, b""]
        name = domain.decode(errors="replace")
        self._refused.add(f"{name}_key")
        self.last = f"{name}: {address.decode(errors='replace')} came with a key that is not allowed"
        return [b"1.0", request, *_NOT_NOW, b"", b""]


def _service(domain: bytes) -> Service | None:
    known: tuple[Any, ...] = get_args(Service)
    return next((name for name in known if name.encode() == domain), None)
