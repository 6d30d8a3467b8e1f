"""The answers of ``health``, ``health.events`` and ``health.history``."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct


class Event(Struct, frozen=True, kw_only=True):
    """A limit that is or was exceeded."""

    number: Annotated[int, Meta(description="counts from the start")]
    rule: Annotated[str, Meta(description="name of the limit in health.limits")]
    quantity: Annotated[str, Meta(description="that exceeded it")]
    level: Annotated[str, Meta(description="warning or ill")]
    text: Annotated[str, Meta(description="a sentence for people")]
    limit: Annotated[float, Meta(description="the limit")]
    worst: Annotated[float, Meta(description="the value farthest beyond")]
    t_ns: Annotated[int, Meta(description="CLOCK_REALTIME of its beginning")]
    ended_ns: Annotated[int, Meta(description="of its end, 0 while it lasts")]
    end: Annotated[str, Meta(description="cleared, unknown or not judged; empty while it lasts")]


class RuleState(Struct, frozen=True, kw_only=True):
    """A limit and its verdict."""

    name: Annotated[str, Meta(description="in health.limits")]
    quantity: Annotated[str, Meta(description="the worst of its quantities")]
    verdict: Annotated[str, Meta(description="ok, warning, ill, unknown or not judged")]
    value: Annotated[float | None, Meta(description="null where unknown")]
    limit: Annotated[float | None, Meta(description="null where none is set")]
    below: Annotated[bool, Meta(description="raised below the limit, not above it")]


class Health(Struct, frozen=True, kw_only=True):
    """The health of a daemon."""

    verdict: Annotated[str, Meta(description="healthy, warning, ill or unknown")]
    state: Annotated[str, Meta(description="as in the status")]
    device: Annotated[str, Meta(description="name of the rig")]
    t_ns: Annotated[int, Meta(description="CLOCK_REALTIME of the evaluated status")]
    uptime_s: Annotated[float, Meta(description="since the start, s")]
    open: Annotated[list[Event], Meta(description="limits that are exceeded now")]
    values: Annotated[dict[str, float | None], Meta(description="every quantity, null where unknown")]
    rules: Annotated[list[RuleState], Meta(description="every limit")]
    windows: Annotated[dict[str, dict[str, Any]], Meta(description="counts and percentiles of 10 s, 60 s, ...")]
    totals: Annotated[dict[str, Any], Meta(description="pairs, clouds, drops and outcomes since the start")]
    clock: Annotated[dict[str, Any], Meta(description="source, synchronised and offset_ms")]
    history: Annotated[dict[str, Any], Meta(description="rows kept, and their memory")]
    look: Annotated[dict[str, Any], Meta(description="images examined, and the time of one")]


class Series(Struct, frozen=True, kw_only=True):
    """One quantity over time; null where it was unknown."""

    mean: Annotated[list[float | None], Meta(description="mean of each interval")]
    low: Annotated[list[float | None], Meta(description="least value")]
    high: Annotated[list[float | None], Meta(description="greatest value")]


class History(Struct, frozen=True, kw_only=True):
    """Quantities over time."""

    period_s: Annotated[float, Meta(description="length of an interval, s")]
    t_s: Annotated[list[float], Meta(description="beginning of each interval, CLOCK_REALTIME, s")]
    series: Annotated[dict[str, Series], Meta(description="by quantity")]
