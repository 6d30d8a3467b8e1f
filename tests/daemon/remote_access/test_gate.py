"""Access through the gate: authorised keys within their roles, and no others."""

from __future__ import annotations

import json
import os
import signal
from contextlib import closing
from pathlib import Path

import pytest
import zmq

from daemon.common.errors import DaemonError
from daemon.keys.key_store import KeyStore
from daemon.remote_access import gate_sink
from daemon.remote_access.gate_messages import GateConfig
from daemon.remote_access.gate_sink import RemoteGate
from fringed import SilenceError, subscribe
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from fringed.keys import new_key
from tests.daemon.remote_access.world import World, pause_for, request, rude
from tools.waiting import wait_until

pytestmark = pytest.mark.timeout(400)
SHORT_S = 1.0  # for clients that must be refused; accepted ones get a long time-out


def test_authorised_keys_read_and_operate(shared: World) -> None:
    shared.lives()
    assert shared.gate.status()["keys"] == 2


def test_a_view_key_may_only_read(shared: World) -> None:
    before = shared.refused("control_role")
    with shared.client(shared.viewer) as client:
        assert client.call("status") == "done"
        shared.called.clear()
        for method in ("set", "stop", "unheard.of", ""):
            with pytest.raises(ControlError, match="this key may only view"):
                client.call(method)
    assert not shared.called
    wait_until(lambda: shared.refused("control_role") == before + 4)


def test_the_refusal_of_a_role_has_its_code(shared: World) -> None:
    with rude(shared, zmq.DEALER, shared.viewer, shared.control_at) as client:
        client.send(request("stop"))
        assert client.poll(60_000)
        answer = json.loads(client.recv())
    assert answer["error"]["code"] == -32001 and answer["id"] == 1


def test_a_key_that_is_not_authorised_neither_reads_nor_operates(shared: World) -> None:
    shared.called.clear()
    assert not shared.sees(shared.stranger, timeout_s=SHORT_S)
    with shared.client(shared.stranger, timeout_s=SHORT_S) as client:
        with pytest.raises(ControlError, match="allow this key"):
            client.call("set", value=1)
        wait_until(lambda: shared.refused("control_key"))
    with closing(subscribe(shared.stream, keys=shared.keys(shared.stranger))):
        wait_until(lambda: shared.refused("stream_key"))
    assert not shared.called
    assert "not allowed" in shared.gate.status()["last_refused"]


def test_a_client_without_a_key_is_refused(shared: World) -> None:
    before = shared.refused("control_handshake")
    shared.called.clear()
    with shared.client(None, timeout_s=SHORT_S) as client:
        with pytest.raises(ControlError, match="needs keys"):
            client.call("set", value=1)
        wait_until(lambda: shared.refused("control_handshake") > before)
    with closing(subscribe(shared.stream, timeout_s=SHORT_S)) as stream, pytest.raises(SilenceError):
        next(stream)
    assert not shared.called


def test_a_password_is_refused(shared: World) -> None:
    before = shared.refused("control_handshake")
    shared.called.clear()
    with zmq.Context() as context, context.socket(zmq.DEALER) as client:
        client.setsockopt(zmq.LINGER, 0)
        client.setsockopt(zmq.PLAIN_USERNAME, b"admin")
        client.setsockopt(zmq.PLAIN_PASSWORD, b"admin")
        client.connect(shared.control_at)
        client.send(request("set", value=1))
        wait_until(lambda: shared.refused("control_handshake") > before)
    assert not shared.called


def test_a_client_sends_nothing_to_a_server_with_another_key(shared: World) -> None:
    shared.called.clear()
    impostor = new_key("impostor")
    assert not shared.sees(shared.viewer, timeout_s=SHORT_S, server=impostor)
    with shared.client(shared.operator, timeout_s=SHORT_S, server=impostor) as client, pytest.raises(ControlError):
        client.call("set", value=1)
    assert not shared.called


def test_a_key_without_its_secret_is_refused(shared: World) -> None:
    """The public half of an authorised key is not secret."""
    thief = new_key("thief")
    with zmq.Context() as context, context.socket(zmq.DEALER) as client:
        client.setsockopt(zmq.LINGER, 0)
        client.setsockopt(zmq.CURVE_SERVERKEY, shared.server.public.encode())
        client.setsockopt(zmq.CURVE_PUBLICKEY, shared.operator.public.encode())
        client.setsockopt(zmq.CURVE_SECRETKEY, str(thief.secret).encode())
        shared.called.clear()
        before = shared.refused("control_handshake")
        client.connect(shared.control_at)
        client.send(request("set", value=1))
        wait_until(lambda: shared.refused("control_handshake") > before)
    assert not shared.called


def test_a_key_for_the_stream_alone_does_not_reach_control(shared: World) -> None:
    key = new_key("screen")
    shared.allow(key, "none")
    assert shared.sees(key)
    with shared.client(key, timeout_s=SHORT_S) as client, pytest.raises(ControlError):
        client.call("status")
    shared.revoke("screen")


def test_a_key_that_is_authorised_later_is_accepted_without_a_restart(shared: World) -> None:
    key = new_key("late")
    with shared.client(key) as client, closing(subscribe(shared.stream, keys=shared.keys(key), timeout_s=60)) as stream:
        refused = shared.refused("control_key")
        with shared.client(key, timeout_s=SHORT_S) as hasty, pytest.raises(ControlError):
            hasty.call("status")
        wait_until(lambda: shared.refused("control_key") > refused)
        shared.allow(key, "view")
        assert client.call("status") == "done"
        assert next(stream).points.size
    shared.revoke("late")


def test_a_revoked_key_loses_its_live_connections_and_others_come_back(shared: World) -> None:
    key = new_key("lost")
    shared.allow(key, "operate")
    with (
        shared.client(key) as client,
        shared.client(shared.operator) as other,
        closing(subscribe(shared.stream, keys=shared.keys(key), timeout_s=60)) as stream,
        closing(subscribe(shared.stream, keys=shared.keys(shared.viewer), timeout_s=60)) as allowed,
    ):
        assert client.call("set", value=1) == other.call("set", value=1) == "done"
        next(stream), next(allowed)
        shared.revoke("lost")
        shared.called.clear()
        client._timeout_s = stream.timeout_s = SHORT_S
        with pytest.raises(ControlError):
            client.call("set", value=2)
        with pytest.raises(SilenceError):
            while True:  # what was on its way still comes
                next(stream)
        assert ("set", {"value": 2}) not in shared.called
        next(allowed)
        assert shared.sees(shared.viewer)
    shared.lives()


def test_a_role_that_is_taken_away_counts_at_the_next_request(shared: World) -> None:
    key = new_key("demoted")
    shared.allow(key, "operate")
    with shared.client(key) as client:
        assert client.call("set", value=1) == "done"
        shared.allow(key, "view")

        def refused() -> bool:
            try:
                client.call("set", value=1)
            except ControlError as error:
                return "only view" in str(error)
            return False

        wait_until(refused)
    shared.revoke("demoted")


def test_a_mistake_in_the_list_changes_nothing_and_is_reported(own: World) -> None:
    path = own.store.directory / "allowed"
    good = path.read_text()
    path.write_text(good + "nonsense\n")
    wait_until(lambda: "allowed:4" in own.gate.status().get("problem", ""))
    own.lives()
    path.write_text(good)
    wait_until(lambda: "problem" not in own.gate.status())


def test_a_new_server_key_is_used_at_once(own: World) -> None:
    own.lives()
    for name in ("server.key", "server.pub"):
        (own.store.directory / name).unlink()
    own.server = own.store.make_server()
    wait_until(lambda: own.gate.status()["cut"].get("stream_server_key"))
    own.lives()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_gate_that_dies_is_restarted_at_the_same_addresses(own: World, number: int) -> None:
    own.lives()
    addresses = own.stream, own.control_at
    os.kill(own.gate.pid, number)
    wait_until(lambda: own.gate.status()["restarts"] == 1 and "problem" not in own.gate.status())
    assert (own.stream, own.control_at) == addresses
    assert own.sees(own.viewer)
    own.operate()


def test_a_gate_that_hangs_is_replaced(own: World, monkeypatch: pytest.MonkeyPatch) -> None:
    own.lives()
    with monkeypatch.context() as impatient:
        impatient.setattr(gate_sink, "_SILENCE_S", 5.0)
        os.kill(own.gate.pid, signal.SIGSTOP)
        wait_until(lambda: own.gate.status()["restarts"])
    assert own.sees(own.viewer)
    own.operate()


def test_a_gate_beyond_its_memory_limit_disconnects_its_clients(shared: World) -> None:
    gate_config = GateConfig(
        stream=["tcp://127.0.0.1:*"],
        control=[],
        source=shared.publisher.endpoints[0],
        target=shared.control.endpoint,
        roles={},
        memory_mb=1,
    )
    with closing(RemoteGate(gate_config, shared.store)) as gate:
        wait_until(lambda: gate.status()["cut"].get("stream_memory"))


def test_keys_have_no_effect_on_local_connections(shared: World) -> None:
    """A user whose environment names keys still reaches the daemon of this machine."""
    local = shared.control.endpoint, shared.publisher.endpoints[0]
    with ControlClient(local[0], timeout_s=60, keys=shared.keys(shared.stranger)) as client:
        assert client.call("status") == "done"
    with closing(subscribe(local[1], timeout_s=60, keys=shared.keys(shared.stranger))) as stream:
        assert next(stream).points.size


def test_a_gate_without_its_daemon_ends(own: World) -> None:
    pid = own.gate.pid
    own.gate.close()
    wait_until(lambda: not os.path.exists(f"/proc/{pid}"))  # noqa: PTH110


def test_a_stop_of_the_whole_group_leaves_the_gate_to_its_daemon(own: World) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(own.gate.pid, number)
    pause_for(0.3)
    own.lives()


def test_an_address_in_use_is_reported(shared: World) -> None:
    gate_config = GateConfig(
        stream=[shared.stream],
        control=[],
        source=shared.publisher.endpoints[0],
        target=shared.control.endpoint,
        roles={},
    )
    with pytest.raises(DaemonError, match="stream: cannot bind"):
        RemoteGate(gate_config, shared.store)


def test_missing_keys_are_reported(shared: World, tmp_path: Path) -> None:
    gate_config = GateConfig(stream=["tcp://127.0.0.1:*"], control=[], source="", target="", roles={})
    with pytest.raises(DaemonError, match="fringed keys server"):
        RemoteGate(gate_config, KeyStore(tmp_path))
    shared.lives()
