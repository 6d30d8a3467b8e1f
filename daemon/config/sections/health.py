"""``health:`` in rig.yaml: rates and limits of the health monitoring."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from daemon.config.sections.section import Section

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, le=1e9)]


class HealthLimits(Section):
    """Limits beyond which an event is raised; ``null`` = not judged. ``least_``: raised below the limit."""

    least_pair_rate_hz: Annotated[Positive | None, Field(description="Pairs a second.")] = None
    least_cloud_rate_hz: Annotated[Positive | None, Field(description="Clouds a second.")] = None
    latency_p99_ms: Annotated[
        Positive | None, Field(description="99 % of the clouds are finished so long after the start of exposure, ms.")
    ] = 500.0
    dropped_share: Annotated[Share | None, Field(description="Pairs that were dropped unmeasured, share.")] = 0.2
    lone_share: Annotated[Share | None, Field(description="Unpaired frames, share.")] = 0.05
    refused_hz: Annotated[
        Annotated[float, Field(ge=0, le=1e6)] | None,
        Field(description="Items a second that recorder, stream or self-check refused."),
    ] = 0.0
    pairing_residual_us: Annotated[
        Positive | None, Field(description="Right minus left start of exposure, median, microseconds.")
    ] = 1000.0
    trigger_jitter_us: Annotated[
        Positive | None, Field(description="Standard deviation of the trigger interval, microseconds.")
    ] = None
    saturated_share: Annotated[Share | None, Field(description="Saturated samples of the worst channel, share.")] = 0.05
    least_modulation: Annotated[
        Annotated[float, Field(gt=0, le=127)] | None,
        Field(description="Fringe amplitude of the weakest channel where there is light, counts."),
    ] = 8.0
    least_lit_share: Annotated[Share | None, Field(description="Pixels with fringes, share of the image.")] = 0.001
    least_lit_coverage: Annotated[Share | None, Field(description="Points, share of the pixels with fringes.")] = 0.001
    least_coverage: Annotated[Share | None, Field(description="Pixels with a point, share.")] = None
    temperature_c: Annotated[
        Annotated[float, Field(gt=0, le=150)] | None, Field(description="Temperature of a camera, degrees Celsius.")
    ] = 70.0
    least_disk_free_gb: Annotated[Positive | None, Field(description="Free space where takes are written, GB.")] = 5.0
    clock_offset_ms: Annotated[Positive | None, Field(description="The clock against its time servers, ms.")] = 10.0
    clock_synchronised: Annotated[bool, Field(description="Raise an event while the clock is unsynchronised.")] = False
    calibration_age_d: Annotated[Positive | None, Field(description="Days since the calibration.")] = 90.0
    memory_mb: Annotated[Positive | None, Field(description="Memory of the daemon, MB.")] = None


class Health(Section):
    """Health monitoring of the daemon."""

    enabled: Annotated[bool, Field(description="Monitor rate, latency, drops, light, disk, clock.")] = True
    looks_hz: Annotated[float, Field(ge=0, le=2, description="Pairs a second whose light is examined; 0 = none.")] = 2.0
    window_s: Annotated[int, Field(ge=2, le=60, description="Seconds over which quantities are evaluated.")] = 5
    raise_s: Annotated[
        float,
        Field(ge=0, le=3600, description="Seconds beyond a limit before an event; over window_s, outliers raise none."),
    ] = 8.0
    clear_s: Annotated[float, Field(ge=0, le=3600, description="Seconds well within it before the event ends.")] = 10.0
    margin: Annotated[float, Field(ge=0, le=0.9, description="How far within its limit is well within, share.")] = 0.1
    history_h: Annotated[float, Field(ge=0.1, le=72, description="Hours of minutes kept in memory.")] = 12.0
    metrics_port: Annotated[
        Annotated[int, Field(ge=0, le=65535)] | None,
        Field(description="Port of Prometheus metrics at 127.0.0.1; null = none, 0 = any free one."),
    ] = None
    limits: HealthLimits = HealthLimits()
