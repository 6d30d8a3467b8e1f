"""The topics of the stream: headers, parts and bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta, Struct

from fringed.protocol.status import Status
from fringed.wire import CloudHeader, Header


class CloudStats(Struct, frozen=True, kw_only=True):
    """``stats`` of a cloud."""

    valid: Annotated[float, Meta(description="share of the pixels with a point, 0 to 1")]
    latency_ms: Annotated[float, Meta(description="start of exposure to finished cloud")]
    dropped: Annotated[int, Meta(description="pairs dropped before the pipeline so far")]
    calibration: Annotated[str | None, Meta(description="consistent, doubtful, inconsistent or unknown")] = None
    reason: Annotated[str | None, Meta(description="why the pair contradicts the calibration")] = None
    every: Annotated[int | None, Meta(description="2: the grid has every second row and column; absent: 1")] = None
    mode: Annotated[str | None, Meta(description="multi-frame mode; absent: single")] = None
    frames: Annotated[int | None, Meta(description="images of the set")] = None
    span_ms: Annotated[float | None, Meta(description="first exposure to last exposure of the set")] = None
    moved: Annotated[int | None, Meta(description="pixels rejected because the scene moved")] = None


class ImageSize(Struct, frozen=True, kw_only=True):
    """``data`` of a preview."""

    width: Annotated[int, Meta(description="of a camera image, pixels")]
    height: Annotated[int, Meta(description="of a camera image, pixels")]


class LogLine(Struct, frozen=True, kw_only=True):
    """``data`` of a log line."""

    level: Annotated[str, Meta(description="info, warning, error or critical")]
    logger: Annotated[str, Meta(description="part of the program, at most 64 characters")]
    text: Annotated[str, Meta(description="the line, at most 500 characters")]


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a message: name, type of the elements, shape, codec, media type (of a file), meaning."""

    name: str
    dtype: str
    shape: str
    text: str
    codec: str = "none"
    media: str = ""
    required: bool = True


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic.

    Args:
        kind: of its header; header: its type; parts: in any order; data, stats: types of these members, if any.
        retained: sent to each new subscriber at once.
        local: only a program on the daemon's machine can use it.
    """

    name: str
    kind: str
    when: str
    text: str
    header: type[Header] = Header
    parts: tuple[Part, ...] = ()
    data: type[Struct] | None = None
    stats: type[Struct] | None = None
    retained: bool = False
    local: bool = False


def _file(name: str, media: str, text: str) -> Part:
    return Part(name, "|u1", "bytes", text, media=media)


_OPTIONAL = (
    Part("rgb", "|u1", "height, width, 3", "colour without fringes, linear", required=False),
    Part("normals", "<f4", "height, width, 3", "unit vectors towards the camera; NaN where unknown", required=False),
    Part("interpolated", "|u1", "height, width", "1: filled in, not measured", required=False),
)
"""Parts that ``outputs.parts`` or a filter adds to every cloud."""

TOPICS = (
    Topic(
        "cloud/full", "cloud", "each cloud", "Points, texture and standard deviation.", CloudHeader,
        (
            Part("xyz", "<f4", "height, width, 3", "points, mm, in the header's frame; NaN where there is none"),
            Part("gray", "|u1", "height, width", "texture"),
            Part("sigma", "<f4", "height, width", "standard deviation along the viewing ray, mm; NaN likewise"),
            *_OPTIONAL,
        ),
        stats=CloudStats,
    ),
    Topic(
        "cloud/parts/NAMES/", "cloud", "each cloud", "The parts that the topic names, with commas, in the order of the "
        "table, xyz among them: cloud/parts/xyz,rgb/. The daemon computes rgb and normals for those who ask.",
        CloudHeader,
        (
            Part("xyz", "<f4", "height, width, 3", "as in cloud/full"),
            Part("gray", "|u1", "height, width", "as in cloud/full", required=False),
            Part("sigma", "<f4", "height, width", "as in cloud/full", required=False),
            *_OPTIONAL,
        ),
        stats=CloudStats,
    ),
    Topic(
        "cloud/shared/NAMES/", "cloud", "each cloud", "The clouds of cloud/parts/NAMES/, or, as cloud/shared/full/, "
        "those of cloud/full, in the daemon's memory; see [shared memory](#shared-memory).", CloudHeader,
        (
            Part("xyz", "<f4", "height, width, 3", "as in cloud/full", "shared"),
            *(
                Part(part.name, part.dtype, part.shape, "as in cloud/full", "shared", required=False)
                for part in (
                    Part("gray", "|u1", "height, width", ""), Part("sigma", "<f4", "height, width", ""), *_OPTIONAL
                )
            ),
        ),
        stats=CloudStats, local=True,
    ),
    Topic(
        "cloud/depth", "cloud", "each cloud", "Depth for slow networks: xyz = z * (rx, ry, 1) with meta/rays of the "
        "same calibration.", CloudHeader,
        (Part("z", "<u2", "height, width", "depth, mm = stored * scale + offset; 0: no point", "blosc2"),),
        stats=CloudStats,
    ),
    Topic(
        "preview", "preview", "at most 10 a second", "Images for people.",
        parts=tuple(
            _file(name, "image/jpeg", text)
            for name, text in (
                ("left", "image of the left camera"), ("right", "image of the right camera"),
                ("overlay", "modulation of the left image, saturated pixels red"),
            )
        ),
        data=ImageSize,
    ),
    Topic("status", "status", "once a second", "The status; keys that do not fit are named in left_out.", data=Status),
    Topic("log", "log", "as it happens", "Log lines of level info and above.", data=LogLine),
    Topic(
        "meta/calibration", "meta", "on change", "The calibration file.", retained=True,
        parts=(_file("calibration", "application/yaml", "the file; its SHA-256 is the header's calibration"),),
    ),
    Topic(
        "meta/rays", "meta", "on change", "Viewing rays of the left camera's pixels.", retained=True,
        parts=(Part("rays", "<f4", "camera height, camera width, 2", "(rx, ry): xyz = z * (rx, ry, 1)"),),
    ),
    Topic(
        "meta/config", "meta", "on change", "The configuration.", retained=True,
        parts=(_file("config", "application/json", "rig.yaml with all defaults"),),
    ),
    Topic(
        "meta/schema", "meta", "on change", "The schema of a cloud's header.", retained=True,
        parts=(_file("schema", "application/schema+json", "JSON Schema"),),
    ),
)  # fmt: skip

RECORDED = tuple(topic for topic in TOPICS if not topic.local)
"""Topics whose messages mean the same on every machine, as recorded ones must."""

_CHOSEN = {"cloud/parts/": "cloud/parts/NAMES/", "cloud/shared/": "cloud/shared/NAMES/"}


def topic_of(name: str) -> Topic:
    """Return the row of a topic, the same for every choice of parts; KeyError for another one."""
    rows = {topic.name: topic for topic in TOPICS}
    chosen = next((row for beginning, row in _CHOSEN.items() if name.startswith(beginning)), name)
    return rows[chosen]
