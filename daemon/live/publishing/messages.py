"""Messages of the stream: clouds, metadata, status and log as ZeroMQ frames."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from daemon.live.items import CloudItem
from fringed import wire
from fringed.errors import WireError
from fringed.parts import BASIC
from pipeline.reconstruct.cloud import Cloud

Frames = list[Any]
Arrays = dict[str, NDArray[Any]]

_REASON_LENGTH = 300
_LOG_CHARACTERS = 500  # up to six bytes each as JSON
_DEPTH_STEP_MM = 0.005  # far below the noise; coarser only where a cloud is deeper than 327 mm
_DEPTH_STEPS = 65534  # from 1 to 65535; 0 is invalid


@dataclass(frozen=True, slots=True)
class Origin:
    """The source of a message; part of every header."""

    device: str
    session: str
    calibration: str

    def keys(self) -> dict[str, Any]:
        """As keys of a header."""
        return {"device": self.device, "session": self.session, "calibration": self.calibration}


def full(origin: Origin, item: CloudItem, parts: Sequence[str] = BASIC) -> Frames:
    """``cloud/full``: points, texture, standard deviation and what is configured; not compressed, not copied.

    Interpolated points are always marked.
    """
    arrays = parts_of_cloud(item.cloud)
    return wire.encode(
        "cloud/full", _cloud_header(origin, item, item.cloud), {name: arrays[name] for name in full_parts(item, parts)}
    )


def full_parts(item: CloudItem, parts: Sequence[str]) -> list[str]:
    """The parts that ``cloud/full`` has of a cloud."""
    wanted = (*parts, "interpolated") if item.cloud.interpolated is not None else parts
    return [name for name in parts_of_cloud(item.cloud) if name in wanted]


def parts(
    origin: Origin, item: CloudItem, topic: str, names: Sequence[str], references: Mapping[str, bytes] | None = None
) -> Frames | None:
    """A cloud with the parts that a topic asks for; None if it was made before they were wanted.

    Args:
        references: to the parts in shared memory, which the message has instead of them.
    """
    available = parts_of_cloud(item.cloud)
    if any(name not in available for name in names):
        return None
    arrays = {name: available[name] for name in names}
    return wire.encode(topic, _cloud_header(origin, item, item.cloud), arrays, references=references)


def parts_of_cloud(cloud: Cloud) -> Arrays:
    """The parts that a cloud has, by their names in messages."""
    filled = np.zeros(cloud.gray.shape, np.uint8) if cloud.interpolated is None else cloud.interpolated
    arrays: dict[str, NDArray[Any] | None] = {
        "xyz": cloud.xyz, "gray": cloud.gray, "sigma": cloud.sigma_mm, "rgb": cloud.rgb, "normals": cloud.normals,
        "interpolated": filled,
    }  # fmt: skip
    return {name: array for name, array in arrays.items() if array is not None}


def depth(origin: Origin, item: CloudItem) -> Frames:
    """``cloud/depth``: z in steps of a few micrometres, compressed; always on the left camera's grid, for its rays."""
    cloud = item.cloud.grid or item.cloud
    stored, scale, offset = quantised(cloud.xyz[..., 2])
    row = {"codec": "blosc2", "scale": scale, "offset": offset}
    return wire.encode("cloud/depth", _cloud_header(origin, item, cloud), {"z": stored}, rows={"z": row})


def quantised(z: NDArray[np.float32]) -> tuple[NDArray[np.uint16], float, float]:
    """Depth as uint16 with scale and offset, mm: z = stored * scale + offset; 0 = invalid."""
    depth = np.array(z, dtype=np.float32, order="C")  # a copy, worked on in place
    least, most = float(np.fmin.reduce(depth, axis=None)), float(np.fmax.reduce(depth, axis=None))
    if not np.isfinite(least):
        least = most = 0.0
    scale = max(_DEPTH_STEP_MM, (most - least) / (_DEPTH_STEPS - 1))
    # The offset is a float32, as the depths are, so that the smallest of them becomes exactly 1.
    offset = float(np.float32(least - scale))
    depth -= np.float32(offset)
    depth *= np.float32(1 / scale)
    depth += np.float32(0.5)
    # fmax takes the number where the other is NaN, minimum guards the last step against rounding.
    np.fmax(depth, np.float32(0), out=depth)
    np.minimum(depth, np.float32(_DEPTH_STEPS + 1), out=depth)
    return depth.astype(np.uint16), scale, offset


def status(origin: Origin, values: dict[str, Any], *, seq: int) -> Frames:
    """``status``: the values in ``data`` of the header; the longest are left out if they do not fit."""
    values = dict(values)
    left_out: list[str] = []
    while True:
        data = values | ({"left_out": left_out} if left_out else {})
        header = wire.Header(kind="status", seq=seq, t_ns=int(values.get("t_ns", 0)), data=data, **origin.keys())
        try:
            return wire.encode("status", header)
        except WireError:
            longest = max(values, key=lambda key: len(msgspec.json.encode(values[key])))
            left_out.append(longest)
            del values[longest]


def log(origin: Origin, *, seq: int, t_ns: int, level: str, logger: str, text: str) -> Frames:
    """``log``: one line, its beginning if it is long."""
    data = {"level": level, "logger": logger[:64], "text": text[:_LOG_CHARACTERS]}
    return wire.encode("log", wire.Header(kind="log", seq=seq, t_ns=t_ns, data=data, **origin.keys()))


def retained(
    origin: Origin, *, calibration: bytes, rays: NDArray[Any], config: dict[str, Any], t_ns: int
) -> dict[str, Frames]:
    """The ``meta/`` messages by topic.

    Args:
        calibration: the bytes of the file; rays: (H, W, 2), so that xyz = z * (rx, ry, 1); config: plain values.
    """
    schema = msgspec.json.schema(wire.CloudHeader)
    return {
        "meta/calibration": _meta(origin, t_ns, "calibration", _bytes(calibration), media="application/yaml"),
        "meta/rays": _meta(origin, t_ns, "rays", rays.astype("<f4")),
        "meta/config": _meta(origin, t_ns, "config", _bytes(_json(config)), media="application/json"),
        "meta/schema": _meta(origin, t_ns, "schema", _bytes(_json(schema)), media="application/schema+json"),
    }


def _meta(origin: Origin, t_ns: int, name: str, array: NDArray[Any], **row: str) -> Frames:
    header = wire.Header(kind="meta", t_ns=t_ns, **origin.keys())
    return wire.encode(f"meta/{name}", header, {name: array}, rows={name: row})


def _bytes(data: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)


def _json(value: Any) -> bytes:
    return json.dumps(value, indent=1, default=str).encode()


def _cloud_header(origin: Origin, item: CloudItem, cloud: Cloud) -> wire.CloudHeader:
    height, width = cloud.gray.shape
    valid = cloud.points / (width * height)
    stats: dict[str, Any] = {"valid": round(valid, 4), "latency_ms": round(item.latency_ms, 2), "dropped": item.dropped}
    consistency = item.cloud.consistency
    if consistency is not None:
        stats["calibration"] = consistency.verdict
        if consistency.verdict == "inconsistent":
            stats["reason"] = consistency.reason[:_REASON_LENGTH]
    if item.stride > 1:
        stats["every"] = item.stride  # the grid has every second row and column of the camera
    if item.frames > 1:
        stats |= {"mode": item.mode, "frames": item.frames, "span_ms": round(item.span_ms, 2), "moved": item.moved}
    return wire.CloudHeader(
        kind="cloud", seq=item.seq, t_ns=item.t_ns, frame=cloud.frame, width=width, height=height, stats=stats,
        **origin.keys(),
    )  # fmt: skip


def differ(a: Frames, b: Frames) -> bool:
    """Whether two messages carry different data, headers aside."""
    return [bytes(part) for part in a[2:]] != [bytes(part) for part in b[2:]]
