"""The option ``--parts`` of commands that write clouds."""

from __future__ import annotations

from typing import Annotated

import typer

PartsOption = Annotated[
    str | None,
    typer.Option(
        "--parts",
        help="What to write of each cloud, with commas: xyz,gray,sigma,rgb,normals,interpolated. Default: xyz,gray; an "
        "npz also has sigma.",
    ),
]


def chosen_parts(text: str | None) -> tuple[str, ...] | None:
    """The parts of the option in their order, None without it; FringedError names what is wrong."""
    from fringed.parts import parse_parts

    return None if text is None else parse_parts(text, "--parts")
