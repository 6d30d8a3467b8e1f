"""``fringed keys``: who may connect from other machines."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from daemon.keys.key_store import KeyStore

app = typer.Typer(add_completion=False, no_args_is_help=True, rich_markup_mode=None)

DirOption = Annotated[
    Path | None,
    typer.Option("--dir", help="Directory of the daemon's keys.", show_default="/etc/fringed/keys, or the user's"),
]
RigOption = Annotated[Path | None, typer.Option(help="Take the directory from this rig.yaml (security.keys).")]


@app.callback()
def _root() -> None:
    """Keys for other machines: on the rig `server`, `allow`, `list` and `revoke`; on the other machine `new`."""


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Of the machine or the person: laptop.")],
    to: Annotated[Path, typer.Option("--to", help="Write the two files here.")] = Path(),
) -> None:
    """Make a key: NAME.key stays with its owner, NAME.pub goes to the rig."""
    from daemon.common.errors import DaemonError
    from daemon.keys.key_store import write_key
    from fringed.keys import new_key

    key = new_key(name)
    files = to / f"{name}.key", to / f"{name}.pub"
    for path in files:
        if path.exists():
            raise DaemonError(f"{path} is there already; it was not changed. Choose another name or remove it")
    write_key(files[0], key, secret=True)
    write_key(files[1], key, secret=False)
    typer.echo(f"{files[0]}: keep it to yourself\n{files[1]}: on the rig, fringed keys allow {files[1].name}")


@app.command()
def server(directory: DirOption = None, rig: RigOption = None) -> None:
    """Make the daemon's own key, if there is none yet; tells the public file for everybody who connects."""
    store = _store(directory, rig)
    key = store.make_server()
    typer.echo(f"{store.public}: give this file to everybody who connects (--server-key)\n{key.public}")


@app.command()
def allow(
    file: Annotated[Path, typer.Argument(help="The public key, NAME.pub.")],
    control: Annotated[str, typer.Option(help="On control: none, view or operate.")] = "none",
    stream: Annotated[str, typer.Option(help="On the stream: none or view.")] = "view",
    name: Annotated[str | None, typer.Option(help="Another name for it.")] = None,
    directory: DirOption = None,
    rig: RigOption = None,
) -> None:
    """Let a key connect; again with other roles to change them. It counts at once, no restart is needed."""
    from daemon.common.errors import DaemonError
    from daemon.keys.authorized_keys import Entry, role
    from fringed.keys import read_key

    key, store = read_key(file), _store(directory, rig)
    try:
        entry = Entry(name or key.name, role("stream", stream), role("control", control), key.public)
    except ValueError as error:
        raise DaemonError(str(error)) from None
    store.make_server()
    store.allow(entry)
    typer.echo(f"{entry.name}: stream {entry.stream}, control {entry.control}; it needs {store.public}")


@app.command("list")
def show(
    directory: DirOption = None,
    rig: RigOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Show every key that may connect, and what it may do."""
    store = _store(directory, rig)
    entries = sorted(store.authorized().entries.values(), key=lambda entry: entry.name)
    if as_json:
        typer.echo(json.dumps([asdict(entry) for entry in entries], indent=2))
        return
    for entry in entries:
        typer.echo(f"{entry.name:24} stream {entry.stream:8} control {entry.control:8} {entry.public}")
    if not entries:
        typer.echo(f"nobody may connect: {store.directory} holds no allowed key")


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(help="Of the key, as `list` shows it.")],
    directory: DirOption = None,
    rig: RigOption = None,
) -> None:
    """Let a key connect no more; a running daemon cuts its connections at once."""
    entry = _store(directory, rig).revoke(name)
    typer.echo(f"{entry.name} may connect no more")


def _store(directory: Path | None, rig: Path | None) -> KeyStore:
    from daemon.common.errors import DaemonError
    from daemon.keys.key_store import KeyStore, default_dir

    if directory is not None:
        return KeyStore(directory)
    if rig is None:
        return KeyStore(default_dir())
    from daemon.config.security import keys_dir

    named = keys_dir(rig)
    if named is None:
        raise DaemonError(f"{rig}: security.keys is missing; write `security: {{keys: keys}}` into it, or use --dir")
    return KeyStore(named)
