"""The unit for desktop PCs: the daemon runs as the logged-in user, who owns all its files."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.nspawn.helpers import MARKS, POLL_S, Fringed, rig
from tools.nspawn.machine import WAIT_S
from tools.waiting import wait_until

pytestmark = MARKS

USER, UNIT = "desk", "fringed-user.service"


class Session:
    """The systemd instance of one user."""

    def __init__(self, fringed: Fringed) -> None:
        self.machine = fringed.machine
        self.uid = self.machine.run("id", "-u", USER).stdout.strip()
        self.env = {"XDG_RUNTIME_DIR": f"/run/user/{self.uid}", "HOME": f"/home/{USER}"}

    def run(self, *command: str, check: bool = True) -> str:
        return self.machine.run(*command, user=USER, env=self.env, check=check).stdout.strip()

    def show(self) -> dict[str, str]:
        output = self.run("systemctl", "--user", "show", UNIT, "--property=ActiveState,MainPID,NRestarts,StatusText")
        return dict(line.partition("=")[::2] for line in output.splitlines())

    def wait(self, what: str, good: Callable[[dict[str, str]], bool]) -> dict[str, str]:
        try:
            wait_until(lambda: good(self.show()), WAIT_S, what, poll_s=POLL_S)
        except TimeoutError as error:
            journal = self.machine.run("journalctl", "--no-pager", "--lines=40").stdout
            raise AssertionError(f"{error}; {self.show()}\n{journal}") from None
        return self.show()


@pytest.fixture(scope="module")
def account(installed: Fringed) -> Iterator[Session]:
    machine = installed.machine
    installed.stop()
    machine.run("useradd", "--create-home", USER)
    made = Session(installed)
    own = {"endpoints": [f"ipc:///run/user/{made.uid}/fringed/stream"]}
    installed.write(
        f"/home/{USER}/.config/fringed/rig.yaml",
        rig(stream=own, control=None, recording={"dir": f"/home/{USER}/takes"}, selfcheck=None),
    )
    # The kernels of the service are copied for this user, which saves compiling.
    machine.run("cp", "-a", "/var/cache/fringed/numba", f"/home/{USER}/kernels")
    installed.write(f"/home/{USER}/.config/fringed/environment", f"NUMBA_CACHE_DIR=/home/{USER}/kernels\n")
    machine.run("chown", "-R", f"{USER}:{USER}", f"/home/{USER}")
    machine.systemctl("start", f"user@{made.uid}.service")
    yield made
    machine.systemctl("stop", f"user@{made.uid}.service")


@pytest.fixture
def session(account: Session) -> Session:
    """A session whose daemon is ready; it is started where no test before has left it running."""
    account.run("systemctl", "--user", "start", "--no-block", UNIT)
    account.wait("the daemon being ready", lambda shown: shown["ActiveState"] == "active")
    return account


def test_the_users_own_systemd_supervises_it(session: Session) -> None:
    session.wait("the status line", lambda shown: "clouds/s" in shown["StatusText"])
    assert "clouds" in session.run("fringed", "status")


def test_its_sockets_are_accessible_to_this_user_only(session: Session) -> None:
    assert session.run("stat", "-c", "%A %U", f"/run/user/{session.uid}/fringed") == f"drwx------ {USER}"


def test_after_sigkill_it_restarts(session: Session) -> None:
    before = session.show()
    session.run("systemctl", "--user", "kill", "--signal=KILL", "--kill-who=main", UNIT)
    after = session.wait(
        "its return", lambda now: now["ActiveState"] == "active" and now["MainPID"] not in ("0", before["MainPID"])
    )
    assert int(after["NRestarts"]) == int(before["NRestarts"]) + 1


def test_it_stops(session: Session) -> None:
    session.run("systemctl", "--user", "stop", UNIT)
    assert session.show()["ActiveState"] == "inactive"
