"""Whether a key may connect is decided by the list alone."""

from __future__ import annotations

import pytest
from zmq.utils import z85

from daemon.common.counters import Counters
from daemon.keys.authorized_keys import AuthorizedKeys, Entry
from daemon.remote_access.gate.zap_handler import ZapHandler
from fringed.keys import Key, new_key

VIEWER, OPERATOR, STRANGER = (new_key(name) for name in ("viewer", "operator", "stranger"))
LIST = AuthorizedKeys(
    {
        VIEWER.public: Entry("viewer", "view", "none", VIEWER.public),
        OPERATOR.public: Entry("operator", "none", "operate", OPERATOR.public),
    }
)


def code(domain: bytes, public: str, *, mechanism: bytes = b"CURVE") -> bytes:
    request = [b"1.0", b"1", domain, b"10.0.0.7", b"", mechanism, z85.decode(public.encode())]
    reply = ZapHandler(lambda: LIST, Counters()).reply(request)
    assert reply[:2] == [b"1.0", b"1"] and len(reply) == 6
    return reply[2]


@pytest.mark.parametrize(
    ("key", "domain", "expected"),
    [
        (VIEWER, b"stream", b"200"),
        (VIEWER, b"control", b"300"),
        (OPERATOR, b"control", b"200"),
        (OPERATOR, b"stream", b"300"),
        (STRANGER, b"stream", b"300"),
        (OPERATOR, b"", b"300"),
        (OPERATOR, b"elsewhere", b"300"),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_a_key_is_accepted_where_the_list_authorises_it(key: Key, domain: bytes, expected: bytes) -> None:
    assert code(domain, key.public) == expected


@pytest.mark.parametrize("mechanism", [b"NULL", b"PLAIN", b"GSSAPI", b""])
def test_no_other_mechanism_is_accepted(mechanism: bytes) -> None:
    assert code(b"control", OPERATOR.public, mechanism=mechanism) == b"400"


@pytest.mark.parametrize(
    "frames", [[], [b"1.0"], [b"1.0"] * 6, [b"1.0", b"1", b"stream", b"", b"", b"CURVE", b"short"]]
)
def test_an_odd_request_is_refused_and_counted(frames: list[bytes]) -> None:
    refused = Counters()
    assert ZapHandler(lambda: LIST, refused).reply(frames)[2] == b"400"
    assert refused.snapshot() == {"request_odd": 1}
