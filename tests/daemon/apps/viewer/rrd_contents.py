"""Reading of .rrd files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def rows(file: Path, entity: str, component: str, timeline: str = "exposure") -> dict[Any, np.ndarray[Any, Any]]:
    """Values of a component by their position on a timeline (times in ns)."""
    from rerun.chunk import RrdReader

    out = {}
    for chunk in RrdReader(str(file)).stream():
        if chunk.entity_path != entity or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        if component in batch.schema.names and timeline in batch.schema.names:
            for position, value in zip(
                batch.column(timeline).cast("int64").to_pylist(), batch.column(component), strict=True
            ):
                out[position] = np.asarray(value.as_py())
    return out


def clouds(file: Path) -> dict[int, np.ndarray[Any, Any]]:
    """Positions (N, 3) by the number of the cloud."""
    return rows(file, "/world/cloud", "Points3D:positions", "cloud")


def entities(file: Path) -> set[str]:
    """Names of all logged entities."""
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(str(file)).stream()}
