"""Requests to encode, from what was typed for a command."""

from __future__ import annotations

from pathlib import Path

from gs_codec.cli.streams import is_stdout
from gs_codec.cli.typed import Typed
from gs_codec.config import CODED_FORMATS, EGS, Config, RateTarget
from gs_codec.encoding.combinations import (
    guides_actions,
    has_target,
    has_views,
    refuse_coding,
    refuse_paper,
    refuse_preparation,
)
from gs_codec.encoding.request import Request
from gs_codec.files.suffixes import format_name, known_suffix
from gs_codec.plan import Plan, Steps


def request_of(typed: Typed, target: Path | None = None, dask: str | None = None) -> Request:
    """The request that was typed, in the format of a target's suffix.

    Raises InvalidInput if an option is out of range, or has no effect.
    """
    if typed["format"] not in (None, *CODED_FORMATS):
        typed.refuse(["format"], f"{typed['format']}: `convert` writes that")
    config, rate = config_of(typed, target), None
    if has_target(typed):
        rate = typed.build(RateTarget)
    return Request(
        config, plan_of(typed, config), rate, tuple(typed.actions),
        typed.has("profile", "coarseness"), typed["max_memory"], typed["max_bytes"], dask,
    )  # fmt: skip


def config_of(typed: Typed, target: Path | None = None) -> Config:
    """The configuration that was typed, with the format of a target's suffix.

    Raises InvalidInput if an option is out of range, or has no effect.
    """
    form = _format_of(typed, target)
    if form in CODED_FORMATS and form != EGS:
        refuse_coding(typed, form, target)
    refuse_paper(typed, Config(typed["profile"]).profile)
    return typed.build(Config, format=form if form in CODED_FORMATS else EGS)


def _format_of(typed: Typed, target: Path | None) -> str:
    """The format of a target's suffix; without a file name, that of the option; "" if unknown."""
    if target is None or is_stdout(target):
        return typed["format"] or EGS
    form = format_name(known_suffix(target))
    if form and typed["format"] not in (None, form):
        typed.refuse(["format"], f"has no effect on {target}, whose suffix sets the format")
    return form


def plan_of(typed: Typed, config: Config) -> Plan | None:
    """The steps and views that were typed; None if none were.

    Raises InvalidInput if an option has no effect in this combination.
    """
    refuse_preparation(typed)
    steps = typed.build(Steps)
    if not steps.wanted and not has_views(typed, config):
        return None
    return typed.build(Plan, steps=steps)


def action_plan(typed: Typed) -> Plan | None:
    """The cameras that guide actions, if any were given.

    Raises InvalidInput if no action uses them.
    """
    return typed.build(Plan) if guides_actions(typed) else None
