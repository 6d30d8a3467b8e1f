"""``fringed keys``: access from other machines."""

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
    name: Annotated[str, typer.Argument(help="Name of the machine or user, such as laptop.")],
    to: Annotated[Path, typer.Option("--to", help="Write the two files here.")] = Path(),
) -> None:
    """Create a key: NAME.key for its owner, NAME.pub for the rig."""
    from daemon.common.errors import InputError
    from daemon.keys.key_store import write_key
    from fringed.keys import new_key

    key = new_key(name)
    files = to / f"{name}.key", to / f"{name}.pub"
    for path in files:
        if path.exists():
            raise InputError(f"{path} exists already and was not changed; choose another name or remove it")
    write_key(files[0], key, secret=True)
    write_key(files[1], key, secret=False)
    typer.echo(f"{files[0]}: keep this file secret\n{files[1]}: on the rig, run fringed keys allow {files[1].name}")


@app.command()
def server(directory: DirOption = None, rig: RigOption = None) -> None:
    """Create the daemon's key unless it exists; print its public file, which every client needs."""
    store = _store(directory, rig)
    key = store.make_server()
    typer.echo(f"{store.public}: copy this file to every client (--server-key)\n{key.public}")


@app.command()
def allow(
    file: Annotated[Path, typer.Argument(help="The public key, NAME.pub.")],
    control: Annotated[str, typer.Option(help="On control: none, view or operate.")] = "none",
    stream: Annotated[str, typer.Option(help="On the stream: none or view.")] = "view",
    name: Annotated[str | None, typer.Option(help="Another name for the key.")] = None,
    directory: DirOption = None,
    rig: RigOption = None,
) -> None:
    """Allow a key to connect, or change its roles; effective at once, without a restart."""
    from daemon.common.errors import InputError
    from daemon.keys.authorized_keys import Entry, role
    from fringed.keys import read_key

    key, store = read_key(file), _store(directory, rig)
    try:
        entry = Entry(name or key.name, role("stream", stream), role("control", control), key.public)
    except ValueError as error:
        raise InputError(str(error)) from None
    store.make_server()
    store.allow(entry)
    typer.echo(f"{entry.name}: stream {entry.stream}, control {entry.control}; the client also needs {store.public}")


@app.command("list")
def show(
    directory: DirOption = None,
    rig: RigOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the allowed keys and their roles."""
    store = _store(directory, rig)
    entries = sorted(store.authorized().entries.values(), key=lambda entry: entry.name)
    if as_json:
        typer.echo(json.dumps([asdict(entry) for entry in entries], indent=2))
        return
    for entry in entries:
        typer.echo(f"{entry.name:24} stream {entry.stream:8} control {entry.control:8} {entry.public}")
    if not entries:
        typer.echo(f"no key may connect: {store.directory} contains no allowed key")


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(help="Name of the key, as printed by `list`.")],
    directory: DirOption = None,
    rig: RigOption = None,
) -> None:
    """Revoke a key; a running daemon closes its connections at once."""
    entry = _store(directory, rig).revoke(name)
    typer.echo(f"{entry.name} is revoked")


def _store(directory: Path | None, rig: Path | None) -> KeyStore:
    from daemon.common.errors import InputError
    from daemon.keys.key_store import KeyStore, default_dir

    if directory is not None:
        return KeyStore(directory)
    if rig is None:
        return KeyStore(default_dir())
    from daemon.config.sections.security import keys_dir

    directory = keys_dir(rig)
    if directory is None:
        raise InputError(f"{rig}: security.keys is missing; add `security: {{keys: keys}}` to it, or use --dir")
    return KeyStore(directory)
