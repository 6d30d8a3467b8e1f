"""One item of a take to a cloud, with the time that it took."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from daemon.apps.replay.independent_verdicts import IndependentVerdicts
from daemon.apps.replay.take_items import TakeItem
from daemon.recording.read.take_reader import TakeReader
from daemon.rig.calibration_file import CalibrationFile
from daemon.rig.camera_serials import serial_problem, serials_in, serials_of_take
from pipeline.common.errors import CalibrationError
from pipeline.common.settings import Settings
from pipeline.monitor.check.checked_reconstructor import Policy
from pipeline.monitor.check.set_check import options_for
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.order_check import order_warning
from pipeline.pattern.sequence import FrameSequence
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import cloud_filters
from pipeline.reconstruct.optional_parts import with_parts
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.pose import Pose
from pipeline.rig.volume import Volume


@dataclass(frozen=True, slots=True)
class Run:
    """One reconstruction of a pair; ``ms`` by stage, ``total_ms`` in total.

    ``consistency``: verdict, reason and readings of the calibration check, None without a check.
    """

    sequence: int
    points: int
    total_ms: float
    ms: dict[str, float]
    consistency: dict[str, Any] | None = None


def warmed_reconstructor(
    calibration: Calibration,
    pattern: ColorFringe | FrameSequence,
    volume: Volume,
    *,
    encoding: str,
    settings: Settings,
    threads: int = 0,
    use_prior: bool = False,
    policy: Policy = "withhold",
    pose: Pose | None = None,
    fuse: bool = False,
) -> Any:
    """A warmed-up reconstructor for images of an encoding: of pairs, or of the sets of a sequence.

    Args:
        pose: into the output frame; fuse: average clouds of surfaces at rest.
    """
    options: dict[str, Any] = {
        "encoding": encoding, "settings": settings, "clock": time.perf_counter_ns, "threads": threads,
    }  # fmt: skip
    filters = cloud_filters(
        calibration, settings, mosaic=encoding.startswith("bayer_"), pose=pose, fuse=fuse, clock=options["clock"]
    )
    if isinstance(pattern, ColorFringe):
        single = IndependentVerdicts(Reconstructor(calibration, pattern, volume, **options), policy, filters)
        single.warm_up(use_prior=use_prior)
        return single
    from pipeline.multi_frame.set_reconstructor import SetReconstructor

    sets = SetReconstructor(calibration, pattern, volume, filters=filters, **options_for(policy), **options)
    sets.warm_up()
    return sets


def check_serials(take: TakeReader, file: CalibrationFile) -> CalibrationFile:
    """The calibration, unless the take was recorded by other cameras than the calibrated ones; CalibrationError."""
    recorded, calibrated = serials_of_take(take.metadata), serials_in(file.mapping["cameras"])
    if problem := serial_problem(calibrated, recorded):
        raise CalibrationError(f"{take.path}: the recording is not of the calibrated cameras: {problem}")
    return file


def problems_of(take: TakeReader, file: CalibrationFile) -> list[str]:
    """Damage of the take, and whether its rig can distinguish fringe orders."""
    sequence = take.sequence()  # of images that carry the order
    warning = "" if sequence is not None else order_warning(file.calibration, take.volume(), take.pattern())
    return [*take.problems, *([f"{take.path}: {warning}"] if warning else [])]


def check_size(item: TakeItem, calibration: Calibration) -> None:
    """Reject a calibration of another image size before any table is built; CalibrationError."""
    for side, image, device in (
        ("left", item.lefts[0], calibration.left), ("right", item.rights[0], calibration.right)
    ):  # fmt: skip
        size = (image.shape[1], image.shape[0])
        if size != device.size:
            raise CalibrationError(
                f"cameras.{side}.size is {list(device.size)}, the recording's {side} images are {list(size)}; use "
                "the calibration of the rig that recorded them"
            )


def timed(reconstructor: Any, item: TakeItem, *, use_prior: bool) -> tuple[Cloud, Run]:
    """The cloud of an item and its times; PipelineError if the pipeline rejects the images."""
    start_ns = time.perf_counter_ns()
    if isinstance(reconstructor, IndependentVerdicts):
        cloud = reconstructor.reconstruct(item.lefts[0], item.rights[0], use_prior=use_prior)
    else:
        cloud = reconstructor.reconstruct(item.lefts, item.rights)
    total_ms = (time.perf_counter_ns() - start_ns) / 1e6
    stages = {name: round(ms, 3) for name, ms in cloud.ms.items()}
    consistency = None if cloud.consistency is None else cloud.consistency.as_mapping()
    return cloud, Run(item.pair.sequence, cloud.points, round(total_ms, 3), stages, consistency)


def with_item_parts(cloud: Cloud, reconstructor: Any, item: TakeItem, parts: Collection[str]) -> Cloud:
    """The cloud of an item with those of the computed parts that are named."""
    single = isinstance(reconstructor, IndependentVerdicts)
    return with_parts(cloud, reconstructor, item.lefts[0] if single else item.lefts, parts)
