"""The tables of the protocol agree with the daemon, and what is generated from them is up to date."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.health_methods import HealthMethods
from daemon.control.methods import Methods
from daemon.control.rpc import background_executor, protocol
from daemon.live.publishing import stream_socket
from daemon.live.status import Status as DaemonStatus
from fringed.protocol import methods, status
from fringed.protocol.limits import ERRORS, LIMITS
from tools import protocol_reference


def daemon_methods() -> dict[str, Any]:
    nothing: Any = None
    made = Methods(
        nothing, nothing, path=None, base_dir=Path(),
        calibrate=CalibrateMethods(nothing, nothing), health=HealthMethods(nothing),
    )  # fmt: skip
    return dict(made.table())


@pytest.mark.parametrize("path", protocol_reference.files(), ids=lambda path: path.name)
def test_generated_files_are_up_to_date(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == protocol_reference.files()[path], "run: make protocol"


def test_the_methods_are_those_of_the_daemon() -> None:
    ours = {
        method.name: (
            tuple(field.name for field in msgspec.structs.fields(method.params)), method.role, method.background
        )
        for method in methods.METHODS
    }  # fmt: skip
    assert ours == {name: (method.params, str(method.role), method.slow) for name, method in daemon_methods().items()}


def test_the_status_has_the_daemon_s_keys() -> None:
    assert {field.name for field in msgspec.structs.fields(status.Status)} == set(DaemonStatus.__dataclass_fields__)


def test_errors_and_limits_are_those_of_the_daemon() -> None:
    names = "PARSE_ERROR INVALID_REQUEST METHOD_NOT_FOUND INVALID_PARAMS INTERNAL_ERROR FAILED FORBIDDEN BUSY"
    assert list(ERRORS) == [getattr(protocol, name) for name in names.split()]
    assert LIMITS["control: request, bytes"] == protocol.MAX_BYTES
    assert LIMITS["control: answer, bytes"] == protocol.MAX_ANSWER_BYTES
    assert LIMITS["control: requests in a batch (this machine only)"] == protocol.MAX_BATCH
    assert LIMITS["control: background requests that wait"] == background_executor.CAPACITY
    assert LIMITS["stream: messages that wait for a slow subscriber"] == stream_socket._SEND_QUEUE
    assert LIMITS["stream: subscription, bytes"] == stream_socket._MAX_PREFIX_BYTES


def test_every_error_code_and_method_is_on_the_page() -> None:
    text = protocol_reference.PAGE.read_text(encoding="utf-8")
    assert all(f"| {code} |" in text for code in ERRORS)
    assert all(f"### {method.name}\n" in text for method in methods.METHODS)
    assert "<!--" not in text
