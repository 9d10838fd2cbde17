"""Encode scenes from requests, for tests of the results."""

from __future__ import annotations

from collections.abc import Mapping

from gs_codec.config import Config, RateTarget, as_rate_target
from gs_codec.encoding.order import encode, encode_to_rate
from gs_codec.encoding.request import Request
from gs_codec.plan import Plan
from gs_codec.report import EncodeReport
from gs_codec.scene import Scene


def as_requested(
    scene: Scene,
    config: Config,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    ply_bytes: int = 1,
) -> tuple[bytes, EncodeReport]:
    """The bytes of an encoded scene, and its report."""
    request = Request(config, plan, as_rate_target(rate))
    parts, report = encode(scene, request, None, ply_bytes)
    return b"".join(parts), report


def to_rate(
    scene: Scene,
    config: Config,
    target: RateTarget,
    plan: Plan | None = None,
    original: Scene | None = None,
) -> tuple[bytes, EncodeReport]:
    """Like `as_requested`, to a target relative to the original; losses are not measured."""
    parts, report = encode_to_rate(scene, original or scene, Request(config, plan, target))
    return b"".join(parts), report
