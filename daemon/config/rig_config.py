"""The model of rig.yaml. Strict: text is not converted to numbers, unknown keys are errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from daemon.config.sections.health import Health
from daemon.config.sections.outputs import Outputs, path_or_inline
from daemon.config.sections.section import Section
from daemon.config.sections.security import Security
from daemon.config.sections.sequence import Mode, Sequencing
from fringed.control import address

Off = BeforeValidator(lambda value: "off" if value is False else value)
"""YAML reads the word off as false."""


class Device(Section):
    """Identity of the rig."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", description="Name in every message.")] = (
        "rig-01"
    )


class Cameras(Section):
    """The two cameras."""

    driver: Annotated[str, Field(description="Name of the camera driver.")]
    left: Annotated[dict[str, Any], Field(description="Options of the left camera.")] = {}
    right: Annotated[dict[str, Any], Field(description="Options of the right camera.")] = {}


class Projector(Section):
    """The projector."""

    driver: Annotated[str, Field(description="Name of the projector driver.")]
    options: Annotated[dict[str, Any], Field(description="Options of the projector.")] = {}


class Pairing(Section):
    """Pairing of left and right frames."""

    tolerance_us: Annotated[float, Field(gt=0, le=1e6, description="Largest difference of the exposures' starts.")] = (
        2000.0
    )
    max_wait_ms: Annotated[float, Field(gt=0, le=60000, description="How long a frame waits for its partner.")] = 500.0
    resync_after: Annotated[int, Field(ge=2, le=100, description="Frames before another trigger count is used.")] = 3


class Volume(Section):
    """Measuring volume along the left camera's z axis."""

    near_mm: Annotated[float, Field(gt=0, le=1e6, description="Nearest surface.")]
    far_mm: Annotated[float, Field(gt=0, le=1e6, description="Farthest surface.")]


class Pipeline(Section):
    """The reconstruction."""

    threads: Annotated[int, Field(ge=0, le=256, description="Worker threads; 0 = all.")] = 0
    queue: Annotated[int, Field(ge=1, le=16, description="Pairs that wait; a new one replaces the oldest.")] = 1
    overload: Annotated[
        Literal["skip", "half"],
        Field(description="Pairs come too fast: skip some, or measure every second pixel until the load falls."),
    ] = "skip"
    temporal_prior: Annotated[
        bool, Field(description="Start a pair from the surface of the one before: faster on a live stream.")
    ] = True
    temporal: Annotated[
        Literal["off", "fuse"],
        Off,
        Field(description="Average clouds where the scene is at rest, up to settings.fusion_clouds of them."),
    ] = "off"
    calibration_check: Annotated[
        Literal["withhold", "warn", "off"],
        Off,
        Field(
            description="Pairs that contradict the calibration: publish them without points, only report them, or do "
            "not check."
        ),
    ] = "withhold"
    cpus: Annotated[
        list[Annotated[int, Field(ge=0, le=4095)]],
        Field(
            max_length=256,
            description="Processors reserved for the pipeline; empty = none. For PCs with four or more.",
        ),
    ] = []
    settings: Annotated[dict[str, bool | int | float], Field(description="Changes to the pipeline's defaults.")] = {}


class Stream(Section):
    """The point-cloud stream."""

    endpoints: Annotated[list[str], Field(min_length=1, max_length=8, description="Where the stream is bound.")] = (
        Field(default_factory=lambda: [address.stream_endpoint(), address.TCP_STREAM])
    )
    allow_remote: Annotated[
        bool, Field(description="Allow addresses that other machines can reach, with keys only.")
    ] = False
    preview_hz: Annotated[float, Field(ge=0, le=10, description="Images a second; 0 = none.")] = 2.0
    shared_memory_mb: Annotated[
        int, Field(ge=0, le=65536, description="Limit of the memory in which programs on this machine read clouds.")
    ] = 256


class Control(Section):
    """The control socket."""

    endpoint: Annotated[str, Field(description="Address of the control socket.")] = Field(
        default_factory=address.control_endpoint
    )
    remote: Annotated[list[str], Field(max_length=8, description="Addresses for other machines, with keys only.")] = []
    allow_remote: Annotated[bool, Field(description="Listen at those addresses.")] = False


class Recording(Section):
    """Directory and limits of takes."""

    dir: Annotated[str, Field(min_length=1, description="Directory of the takes.")] = "takes"
    max_part_mb: Annotated[int, Field(ge=16, le=1_000_000, description="Size at which a new part begins.")] = 2048
    max_part_s: Annotated[float, Field(ge=1, le=86400, description="Duration at which a new part begins.")] = 600.0
    min_free_mb: Annotated[int, Field(ge=0, description="Free space that recording leaves.")] = 1024
    queue: Annotated[int, Field(ge=2, le=1000, description="Pairs that wait for the disk.")] = 60
    before_s: Annotated[
        float,
        Field(ge=0, le=3600, description="Seconds kept in memory, for takes that begin before their start."),
    ] = 0.0
    before_mb: Annotated[
        int, Field(ge=1, le=1_000_000, description="Memory limit of before_s, which then keeps less.")
    ] = 1024
    sync: Annotated[
        Literal["chunk", "1s", "none"],
        Field(description="Takes are synchronised with the disk after each pair, each second, or after a part."),
    ] = "1s"
    retry_s: Annotated[
        float, Field(ge=0.1, le=60, description="How often a take that the disk interrupted tries to resume.")
    ] = 1.0
    endless: Annotated[
        bool, Field(description="Remove the oldest parts of the running take instead of stopping for lack of space.")
    ] = False
    keep_mb: Annotated[
        int, Field(ge=0, le=1_000_000_000, description="Endless: size of the take at most; 0 = up to min_free_mb.")
    ] = 0
    keep_s: Annotated[
        float,
        Field(ge=0, le=1e8, description="Endless: parts older than this are removed, seconds; 0 = no limit."),
    ] = 0.0


class SelfCheckLimits(Section):
    """Reported changes since the reference was learned."""

    column_px: Annotated[
        float, Field(gt=0, le=10, description="Trinocular residual: observed minus expected projector column, pixels.")
    ] = 0.04
    column_slope_px: Annotated[
        float, Field(gt=0, le=10, description="The same, from the middle of the image to its edge.")
    ] = 0.012
    epipolar_px: Annotated[float, Field(gt=0, le=10, description="Right image across the epipolar lines, pixels.")] = (
        0.1
    )
    color_rad: Annotated[
        float, Field(gt=0, le=1, description="Phase of a colour channel against the others, radians.")
    ] = 0.006
    modulation: Annotated[float, Field(gt=0, le=1, description="Fringe amplitude over mean light.")] = 0.15
    off_px: Annotated[
        float, Field(gt=0, le=10, description="Residual that is reported whatever the reference was, pixels.")
    ] = 0.6


class SelfCheck(Section):
    """The continuous check of the calibration from ordinary pairs."""

    enabled: Annotated[bool, Field(description="Monitor whether the calibration still fits.")] = True
    rate_hz: Annotated[float, Field(gt=0, le=20, description="Examined pairs a second, at most.")] = 5.0
    dir: Annotated[str, Field(min_length=1, description="Directory of its references and its history.")] = "selfcheck"
    limits: SelfCheckLimits = SelfCheckLimits()


PathOrVolume = Annotated[
    Annotated[str, Tag("path")] | Annotated[Volume, Tag("inline")],
    Discriminator(path_or_inline),
    Field(description="Path of a volume.json, or near_mm and far_mm."),
]
PathOrPattern = Annotated[
    Annotated[str, Tag("path")] | Annotated[dict[str, Any], Tag("inline")],
    Discriminator(path_or_inline),
    Field(description="Path of a pattern.json, or the pattern itself."),
]


class RigConfig(Section):
    """Configuration of a rig for `fringed run`."""

    device: Device = Device()
    cameras: Cameras
    projector: Projector | None = None
    simulation: Annotated[dict[str, Any], Field(description="Options of the simulated rig.")] = {}
    calibration: Annotated[str | None, Field(description="Path of calibration.yaml.")] = None
    pattern: PathOrPattern | None = None
    volume: PathOrVolume | None = None
    mode: Mode = "single"
    preset: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$",
            description="Overload, temporal fusion and settings that the section pipeline does not have: precise, "
            "balanced, fast, dynamic, or a file presets/NAME.yaml beside this one.",
        ),
    ] = "balanced"
    sequence: Sequencing = Sequencing()
    pairing: Pairing = Pairing()
    pipeline: Pipeline = Pipeline()
    outputs: Outputs = Outputs()
    stream: Stream = Field(default_factory=Stream)
    control: Control = Field(default_factory=Control)
    recording: Recording = Recording()
    selfcheck: SelfCheck = SelfCheck()
    health: Health = Health()
    security: Security = Security()

    def path(self, name: str, base_dir: Path) -> Path:
        """Resolve a path of the file; relative ones start at the directory of rig.yaml."""
        return base_dir / Path(name).expanduser()
