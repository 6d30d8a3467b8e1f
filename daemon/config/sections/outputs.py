"""``outputs:`` in rig.yaml: the parts of every cloud, and its frame."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag

from daemon.config.sections.section import Section
from fringed.errors import FringedError
from fringed.parts import BASIC, PARTS, parse_parts


def _checked(parts: Any) -> Any:
    """Names of parts in the order of messages; what is no list of text is left to the model."""
    if not (isinstance(parts, list) and all(isinstance(name, str) for name in parts)):
        return parts
    try:
        checked = parse_parts(parts, "the list")
    except FringedError as error:
        raise ValueError(str(error)) from None
    missing = [name for name in BASIC if name not in checked]
    if missing:
        raise ValueError(f"{', '.join(missing)} is missing; readers of cloud/full need {', '.join(BASIC)}")
    return list(checked)


def path_or_inline(value: Any) -> str:
    """The tag of a value that is a path or stands in rig.yaml itself."""
    return "path" if isinstance(value, str) else "inline"


Row = Annotated[list[float], Field(min_length=4, max_length=4)]
PathOrPose = Annotated[
    Annotated[str, Tag("path")] | Annotated[list[Row], Field(min_length=4, max_length=4), Tag("inline")],
    Discriminator(path_or_inline),
    Field(
        description="Frame of the clouds: path of a pose file, or the rigid 4 x 4 matrix of X_out = M X_left, mm; "
        "without it the left camera's frame."
    ),
]


class Outputs(Section):
    """What every cloud carries, and its frame."""

    parts: Annotated[
        list[str],
        BeforeValidator(_checked),
        Field(
            min_length=len(BASIC),
            max_length=len(PARTS),
            description="Parts of cloud/full and of snapshots: xyz, gray, sigma, and what else every cloud shall carry "
            "of rgb, normals, interpolated. Subscribers may ask for these by topic without it.",
        ),
    ] = list(BASIC)
    frame: PathOrPose | None = None
