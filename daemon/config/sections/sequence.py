"""``mode`` and ``sequence:`` in rig.yaml: the images of a cloud and their projection."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from daemon.config.sections.section import Section

MODES = ("single", "two_color", "heterodyne", "gray")
Mode = Annotated[
    Literal["single", "two_color", "heterodyne", "gray"],
    Field(
        description="Images of a cloud: a single one, for scenes that move, or several, for scenes at rest: two "
        "colour fringes, three frequencies in steps, Gray code and steps."
    ),
]


class Sequencing(Section):
    """The images of a multi-frame mode."""

    display: Annotated[
        Literal["driven", "stored"],
        Field(
            description="driven: the daemon shows each image and waits for a pair exposed under it. stored: "
            "the projector stores the images, and each trigger shows the next one."
        ),
    ] = "driven"
    first_trigger: Annotated[
        int, Field(ge=0, lt=1 << 32, description="Number of a trigger that shows the first image; for stored ones.")
    ] = 0
    settle_ms: Annotated[
        float | None,
        Field(
            ge=0,
            le=2000,
            description="From an image's flip to the first exposure that counts; none = the projector's latency and a "
            "margin. For driven ones.",
        ),
    ] = None
    periods: Annotated[
        float | None, Field(ge=4, le=2048, description="Periods of the finest fringe; none = those of the pattern.")
    ] = None
    steps: Annotated[int | None, Field(ge=3, le=16, description="Images of a fringe; none = the mode's own.")] = None
