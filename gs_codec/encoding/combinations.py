"""Reject options that have no effect in a combination; all such checks are here.

`check_*` functions check values, for every caller. `refuse_*` functions check the typed options of
a command, and reject one even if it was typed with its default.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from gs_codec.config import (
    ADAPTIVE_PROFILES,
    EGS,
    PAPER_OPTIONS,
    PROFILES,
    Config,
    RateTarget,
    options_of,
)
from gs_codec.edit.actions import KINDS, Action
from gs_codec.errors import InvalidInput
from gs_codec.format_table import FORMATS, TILESET, format_of, format_of_file
from gs_codec.plan import Plan, Steps

_ADAPTIVE = ", ".join(ADAPTIVE_PROFILES)

#: Formats in which scenes are encoded below a memory limit.
_IN_PARTS = ", ".join(each.name for each in FORMATS if each.in_parts and each.writes == "steps")

# Values, for all callers


def check_request(
    config: Config,
    plan: Plan | None,
    rate: RateTarget | None,
    actions: Sequence[Action],
    max_memory: int | None,
    dask: str | None,
) -> None:
    """Check the fields of a `Request`. Raises InvalidInput."""
    config.check_options_of(config.scene_format)
    if dask is not None:
        _check_divided(config, plan is not None or rate is not None or bool(actions))
    elif max_memory is not None:
        if plan is not None or rate is not None:
            raise InvalidInput("max-memory: cannot be combined with views, preparation or a target")
        _check_levels(config)
        if not config.scene_format.in_parts:
            raise InvalidInput(f"max-memory: format '{config.format}', expected {_IN_PARTS}")
    check_actions(actions, plan, max_memory is not None, coded=plan is not None)
    if config.effort == "high" and config.format == EGS and plan is None:
        raise InvalidInput("effort 'high': has no effect on an .egs without cameras")
    if rate is not None:
        _check_rate(config, rate, Steps() if plan is None else plan.steps)


def check_conversion(
    target: str | Path,
    suffix: str,
    config: Config,
    plan: Plan | None,
    actions: Sequence[Action],
    max_memory: int | None,
    at: Sequence[float] | None = None,
) -> None:
    """Check the options of a conversion to the format of a suffix. Raises InvalidInput."""
    if at is not None and suffix != TILESET:
        raise InvalidInput(f"{target}: at: has no effect, expected {TILESET}")
    if max_memory is not None and not format_of(suffix).in_parts:
        known = [s for each in FORMATS if each.in_parts for s in each.written]
        raise InvalidInput(f"{target}: max-memory: expected one of {', '.join(known)}")
    if max_memory is not None and suffix == f".{EGS}":
        _check_levels(config)
    check_actions(actions, plan, max_memory is not None)


def check_actions(
    actions: Sequence[Action], plan: Plan | None, limited: bool, coded: bool = False
) -> None:
    """Reject actions that a memory limit rules out, or that move a scene relative to its cameras.

    Moving is rejected if the cameras guide other actions or, if `coded`, the encoder.
    """
    given, moved = plan is not None and not plan.estimates, None
    for action in actions:
        kind = KINDS[action.name]
        if not kind.local and limited:
            raise InvalidInput(
                f"{action.typed}: needs the whole scene in memory, without max-memory"
            )
        if kind.guided and given and moved is not None:
            raise InvalidInput(f"{action.typed}: the cameras no longer fit after {moved.typed}")
        moved = action if kind.does == "move" else moved
    if coded and given and moved is not None:
        raise InvalidInput(
            f"{moved.typed}: the given cameras do not fit the moved scene, expected none or auto"
        )


def _check_levels(config: Config) -> None:
    """Reject levels of detail below a memory limit, unless workers divide the scene."""
    if config.lod:
        raise InvalidInput("lod: with max-memory, dask is needed too")


def _check_divided(config: Config, others: bool) -> None:
    """Reject options that need all Gaussians at once."""
    if others:
        raise InvalidInput("dask: cannot be combined with views, preparation, actions or a target")
    if config.profile not in ADAPTIVE_PROFILES or config.format != EGS:
        raise InvalidInput(f"dask: profile '{config.profile}', expected {_ADAPTIVE} of an .egs")
    if config.depths:
        raise InvalidInput("dask: cannot be combined with depths, which need the whole scene")
    if config.extra == "keep":
        raise InvalidInput('dask: extra properties are not kept, expected extra="drop"')


def _check_rate(config: Config, rate: RateTarget, steps: Steps) -> None:
    """Reject a target that no step sizes or pruning can meet, or that another option meets."""
    if config.lod:
        raise InvalidInput("lod: cannot be combined with a target: coarser levels add a third")
    if config.profile not in ADAPTIVE_PROFILES:
        raise InvalidInput(
            f"target: profile '{config.profile}' has fixed steps, expected {_ADAPTIVE}"
        )
    if config.strict and rate.psnr_drop is None:
        raise InvalidInput("strict: has no effect with a target size, which sets the loss")
    if rate.allow_prune and steps.balanced:
        raise InvalidInput("allow_prune: not needed with refine, which prunes to meet a target")
    prunes = steps.by_leave_one_out and not steps.balanced
    if not config.has_steps and (rate.allow_prune or prunes):
        what = "allow_prune" if rate.allow_prune else "pruning"
        raise InvalidInput(
            f"{what}: a target for format '{config.format}' sets the number of Gaussians"
        )


# Typed options, for commands


class Typed(Protocol):
    """The typed options of a command."""

    @property
    def actions(self) -> Sequence[Action]:
        """The typed actions, in order."""

    def __getitem__(self, name: str) -> Any:
        """The value of an option by its name."""

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Reject these options if they were typed; `why` states what they need."""


#: Options of `Config` that also apply to other formats than `.egs`; and those for formats without
#: encoding.
_OF_ALL = ("extra", "nonfinite", "threads", "format")
_OF_STEPS = ("profile", "coarseness")

#: Options for the size or quality of a file.
_TARGETS = ("target_size", "target_ratio", "target_bpg", "target_bitrate", "max_psnr_drop")

_OF_VIEWS = ("views", "width", "background")


def refuse_coding(typed: Typed, form: str, target: Path | None) -> None:
    """Reject coding options that have no effect on a format other than `.egs`."""
    where, known = target or form, format_of(f".{form}")
    known = known.variants.get(typed["gltf_compression"], known)
    settings: list[Any] = [Config]
    if known.writes == "floats":
        settings += [RateTarget, Steps]
        typed.refuse(["gt_images", "device"], f"has no effect on {where}")
    written = (target and format_of_file(target.name)) or known  # streamed SOG is coded as SOG
    used = (*_OF_ALL, *known.options, *written.options)
    used += _OF_STEPS if known.writes == "steps" else ()
    used += ("strict",) if known.writes == "steps" and written.writes != "levels" else ()
    used = (*used, "max_memory") if written.in_parts else used
    names = [each.name or field for kind in settings for field, each in options_of(kind).items()]
    unused = [name for name in ("preset", "max_memory", *names) if name not in used]
    for name in unused:
        suffixes = [s for each in FORMATS if name in each.options for s in each.written]
        expected = ", ".join(suffixes) or "an .egs"
        typed.refuse([name], f"has no effect on {where}, expected {expected}")


def refuse_paper(typed: Typed, profile: str) -> None:
    """Reject options of paper profiles that have no effect on another."""
    if profile in PROFILES:
        return
    known = ", ".join(PROFILES)
    typed.refuse(["preset"], f"uses {known}, not profile '{profile}'")
    why = f"has no effect on profile '{profile}', expected one of {known}"
    typed.refuse(("geometry", "tmc3", "verify", *PAPER_OPTIONS), why)


def has_target(typed: Typed) -> bool:
    """Whether a size or a quality was typed; rejects options that need one."""
    if _has_target(typed):
        typed.refuse(["coarseness"], "has no effect with a target, which sets the step sizes")
        return True
    typed.refuse(["allow_prune"], "needs a size or a quality, for example --target-ratio 30")
    return False


def _has_target(typed: Typed) -> bool:
    return any(typed[name] is not None for name in _TARGETS)


def refuse_preparation(typed: Typed) -> None:
    """Reject options of preparation steps that do not run."""
    if not typed["prune_geometry"]:
        typed.refuse(["geometry_rule"], "needs --prune-geometry")
    if not typed["refine"]:
        typed.refuse(["checkpoint"], "needs --refine, whose state it saves")
        typed.refuse(["device"], "needs --refine")


def has_views(typed: Typed, config: Config) -> bool:
    """Whether coding without preparation is camera-guided; rejects options without effect."""
    profile, measured = config.profile, typed["max_psnr_drop"] is not None
    if not measured:
        typed.refuse(["gt_images"], "needs --prune, --refine or --max-psnr-drop")
    if profile not in ADAPTIVE_PROFILES:
        why = f"has no effect on profile '{profile}', expected {_ADAPTIVE}, --prune or --refine"
        typed.refuse(["cameras", *_OF_VIEWS], why)
    # If step sizes cannot be chosen, pruning meets the target.
    prunes = config.scene_format.writes != "steps" and _has_target(typed)
    if config.scene_format.is_exact and not prunes:
        why = f"has no effect on .{config.format}, whose values are exact: use --prune or --refine"
        typed.refuse(["cameras", *_OF_VIEWS], why)
    if typed["cameras"] is not None or measured or typed["allow_prune"] or prunes:
        return True
    typed.refuse(_OF_VIEWS, "has no effect without views, expected --cameras, --prune or --refine")
    return False


def guides_actions(typed: Typed) -> bool:
    """Whether cameras guide actions; rejects views that guide none."""
    guided = [action for action in typed.actions if KINDS[action.name].guided]
    if typed["cameras"] == "auto" and {action.name for action in guided} == {"remove-floaters"}:
        why = "'auto' has no effect on --remove-floaters, which needs cameras from a file"
        typed.refuse(["cameras"], why)
    if typed["cameras"] is not None and guided:
        return True
    known = ", ".join(f"--{name}" for name, kind in KINDS.items() if kind.guided)
    why = "has no effect without --cameras" if guided else f"needs one of {known}"
    typed.refuse(["cameras", *_OF_VIEWS], why)
    return False
