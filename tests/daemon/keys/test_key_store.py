"""Key files and the list of authorised keys: complete or refused, and secrets stay secret."""

from __future__ import annotations

import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.cli.entry import run
from daemon.common.errors import DaemonError
from daemon.keys import authorized_keys
from daemon.keys.authorized_keys import Entry
from daemon.keys.key_store import KeyStore, write_key
from fringed import KeyFileError, Keys
from fringed.keys import is_z85, new_key, parse_key, read_key


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_key_comes_back_from_its_files_as_it_was(tmp_path: Path) -> None:
    key, server = new_key("laptop"), new_key("server")
    write_key(tmp_path / "laptop.key", key, secret=True)
    write_key(tmp_path / "laptop.pub", key, secret=False)
    write_key(tmp_path / "server.pub", server, secret=False)
    assert read_key(tmp_path / "laptop.key", secret=True) == key
    assert read_key(tmp_path / "laptop.pub").secret is None
    assert Keys.load(tmp_path / "laptop.key", tmp_path / "server.pub").server == server.public
    assert mode(tmp_path / "laptop.key") == 0o600


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("name: laptop", "name: ../x"), "k:2: a name has"),
        (lambda text: text.replace("public: ", "public: x"), "k:3: the public key is not"),
        (lambda text: text.replace("secret: ", "secret: x"), "k:4: the secret key is not"),
        (lambda text: text + "name: laptop\n", "k:5: name is defined twice"),
        (lambda text: text + "what\n", "k:5: expected one of"),
        (lambda text: text.replace("name", "#name"), "k: name is missing"),
        (
            lambda text: parse_key(text, "k").text(secret=True).replace(text[-41:-1], new_key("x").secret or ""),
            "do not match",
        ),
    ],
)
def test_a_mistake_in_a_key_file_is_reported_with_its_line_and_without_the_secret(change: object, message: str) -> None:
    key = new_key("laptop")
    with pytest.raises(KeyFileError) as caught:
        parse_key(change(key.text(secret=True)), "k")  # type: ignore[operator]
    assert message in str(caught.value) and key.secret not in str(caught.value)


def test_a_secret_that_others_can_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "laptop.key"
    write_key(path, new_key("laptop"), secret=True)
    path.chmod(0o644)
    with pytest.raises(KeyFileError, match="others can read"):
        read_key(path)


@settings(max_examples=300, deadline=None)
@given(st.text(max_size=300))
def test_any_text_is_a_key_or_an_error_of_ours(text: str) -> None:
    for parse in (parse_key, authorized_keys.parse):
        try:
            parse(text, "x")
        except (KeyFileError, DaemonError) as error:
            assert str(error).startswith("x")


@settings(max_examples=200, deadline=None)
@given(st.binary(min_size=32, max_size=32))
def test_z85_is_recognised_by_the_bytes_it_encodes(data: bytes) -> None:
    from zmq.utils import z85

    text = z85.encode(data).decode()
    assert is_z85(text) and not is_z85(text[:-1]) and not is_z85(text[:-1] + "~") and not is_z85("#" * 40)


def entry(name: str, control: str = "view") -> Entry:
    return Entry(name, "view", authorized_keys.role("control", control), new_key(name).public)


def test_a_key_is_authorised_changed_and_revoked_and_comments_stay(tmp_path: Path) -> None:
    store = KeyStore(tmp_path / "keys")
    store.make_server()
    first, second = entry("laptop"), entry("bench", "operate")
    store.allow(first)
    with (store.directory / "allowed").open("a") as file:
        file.write("# the one in the hall\n")
    store.allow(second)
    assert store.authorized().role("control", second.public) == "operate"
    store.allow(Entry("laptop", "none", "view", first.public))
    assert store.authorized().role("stream", first.public) == "none"
    store.revoke("bench")
    assert list(store.authorized().entries) == [first.public]
    assert "# the one in the hall" in (store.directory / "allowed").read_text()
    with pytest.raises(DaemonError, match="no key is named 'bench'"):
        store.revoke("bench")


def test_the_same_key_under_two_names_is_refused_and_the_list_stays(tmp_path: Path) -> None:
    store = KeyStore(tmp_path)
    first = entry("laptop")
    store.allow(first)
    before = (tmp_path / "allowed").read_bytes()
    with pytest.raises(DaemonError, match="is already in line 2"):
        store.allow(Entry("other", "view", "operate", first.public))
    assert (tmp_path / "allowed").read_bytes() == before


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("laptop view view", ":1: 3 fields"),
        ("laptop see view " + "0" * 40, ":1: 'see' is no role on stream; there are none, view"),
        ("laptop view boss " + "0" * 40, ":1: 'boss' is no role on control"),
        ("laptop view view short", ":1: the key of laptop"),
        (".x view view " + "0" * 40, ":1: the name"),
    ],
)
def test_a_mistake_in_the_list_is_reported_with_its_line(line: str, message: str) -> None:
    with pytest.raises(DaemonError) as caught:
        authorized_keys.parse(line + "\n", "allowed")
    assert message in str(caught.value)


def test_a_list_that_others_can_change_is_not_used(tmp_path: Path) -> None:
    store = KeyStore(tmp_path)
    store.allow(entry("laptop"))
    (tmp_path / "allowed").chmod(0o666)
    with pytest.raises(DaemonError, match="others can change it"):
        store.authorized()


def test_programs_that_change_the_list_at_the_same_time_lose_nothing(tmp_path: Path) -> None:
    entries = [entry(f"key-{i}") for i in range(24)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda one: KeyStore(tmp_path).allow(one), entries))
    assert set(KeyStore(tmp_path).authorized().entries) == {one.public for one in entries}


@pytest.mark.parametrize(("directory", "secret"), [(0o700, 0o600), (0o750, 0o640), (0o755, 0o600)])
def test_secrets_are_for_the_owner_or_for_the_group_that_the_directory_is_shared_with(
    tmp_path: Path, directory: int, secret: int
) -> None:
    keys = tmp_path / "keys"
    keys.mkdir()
    keys.chmod(directory)
    store = KeyStore(keys)
    store.make_server()
    store.allow(entry("laptop"))
    assert {name: mode(keys / name) for name in ("server.key", "allowed", "server.pub")} == {
        "server.key": secret,
        "allowed": secret,
        "server.pub": 0o644,
    }
    assert store.make_server() == store.server()  # never created again


def test_the_command_makes_allows_lists_and_revokes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = str(tmp_path / "keys")
    assert run(["keys", "new", "laptop", "--to", str(tmp_path)]) == 0
    public = tmp_path / "laptop.pub"
    assert run(["keys", "allow", str(public), "--control", "operate", "--dir", keys]) == 0
    assert run(["keys", "list", "--dir", keys]) == 0
    assert read_key(public).public in capsys.readouterr().out
    assert run(["keys", "new", "laptop", "--to", str(tmp_path)]) == 2
    assert run(["keys", "allow", str(public), "--control", "boss", "--dir", keys]) == 2
    assert "exists already" in (message := capsys.readouterr().err) and "'boss' is no role" in message
    assert run(["keys", "revoke", "laptop", "--dir", keys]) == 0
    assert run(["keys", "list", "--dir", keys]) == 0
    assert "no key may connect" in capsys.readouterr().out


def test_the_command_finds_the_directory_in_the_rig_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras: {driver: sim}\nsecurity: {keys: secrets}\n")
    assert run(["keys", "server", "--rig", str(rig)]) == 0
    assert (tmp_path / "secrets" / "server.key").is_file()
    rig.write_text("cameras: {driver: sim}\n")
    assert run(["keys", "server", "--rig", str(rig)]) == 2
    assert "security.keys is missing" in capsys.readouterr().err


@pytest.mark.parametrize("given", [["--key", "x.key"], ["--server-key", "x.pub"]])
def test_both_options_belong_together(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["status", *given]) == 2
    assert "belong together" in capsys.readouterr().err
