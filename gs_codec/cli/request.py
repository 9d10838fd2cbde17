"""The typed options of a command."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from gs_codec.cli.actions import action_parameters, typed_actions
from gs_codec.cli.options import DEFAULTS, OPTIONS, metavar_of, typed_name, typer_option
from gs_codec.cli.output import set_loudness
from gs_codec.cli.streams import is_stdout
from gs_codec.config import (
    ADAPTIVE_PROFILES,
    CODED_FORMATS,
    EGS,
    PAPER_OPTIONS,
    PROFILES,
    Config,
    RateTarget,
    options_of,
)
from gs_codec.edit.actions import KINDS
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import format_name, known_suffix
from gs_codec.formats.table import format_of
from gs_codec.preparation.presets import PRESETS
from gs_codec.preparation.steps import Plan, Steps

Settings = TypeVar("Settings", Config, RateTarget, Plan, Steps)


class Typed:
    """The typed options of a command.

    Parameters
    ----------
    ctx : typer.Context
    values : dict
        The command's parameters by name.

    Attributes
    ----------
    command : str
        Its name.
    actions : list of Action
        In the order typed.
    """

    def __init__(self, ctx: typer.Context, values: dict[str, Any]) -> None:
        self.command = ctx.info_name
        self._values: dict[str, Any] = {
            name: dict(value) if name in OPTIONS and OPTIONS[name].keys else value
            for name, value in values.items()
            if value is not None
        }
        self._typed = {name for name in values if is_given(ctx, name)}
        self.actions = typed_actions(ctx, values)
        if preset := self._values.get("preset"):
            chosen = PRESETS[preset].options()
            self._values |= {n: value for n, value in chosen.items() if n not in self._typed}

    def __getitem__(self, name: str) -> Any:
        return self._values.get(name)

    def has(self, *names: str) -> bool:
        """Whether any of these options was typed."""
        return not self._typed.isdisjoint(names)

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Reject options that would be ignored.

        Raises
        ------
        InvalidInput
            If one was typed; `why` states what it needs.
        """
        for name in names:
            if name in self._typed:
                raise InvalidInput(f"{typed_name(name)} {why}")

    def build(self, settings: type[Settings], **others: Any) -> Settings:
        """Build a dataclass of the library from typed options and `others`."""
        names = {field: each.name or field for field, each in options_of(settings).items()}
        found = {field: self._values[name] for field, name in names.items() if name in self._values}
        return settings(**found | others)


def takes(
    *names: str,
    expert: Iterable[type] = (),
    without: Iterable[str] = (),
    hidden: Sequence[str] = (),
    actions: Sequence[str] = (),
    actions_hidden: bool = False,
    **defaults: Any,
) -> Callable[[Callable[..., None]], Any]:
    """Give a command options by name, and the expert ones of dataclasses.

    The typed options are passed as the command's parameter `typed`. `defaults` are defaults that
    differ from the library's; `without` are expert options that the command does not have; `hidden`
    are others that the help lists with the expert ones. `actions` are the names of its actions,
    available in `Typed.actions`; the help may hide them.
    """
    experts = [
        name
        for settings in expert
        for field, described in options_of(settings).items()
        if described.expert and (name := described.name or field) not in (*names, *without)
    ]
    experts += hidden

    names = (*names, "quiet", "verbose")

    def decorate(command: Callable[..., None]) -> Any:
        own = inspect.signature(command, eval_str=True).parameters.values()
        kept = [p.replace(kind=p.KEYWORD_ONLY) for p in own if p.name != "typed"]
        shared = [
            _parameter(name, (DEFAULTS | defaults).get(name), name in experts)
            for name in (*names, *experts)
        ]

        def called(ctx: typer.Context, **values: Any) -> None:
            quiet, verbose = values.pop("quiet"), values.pop("verbose")
            if quiet and verbose:
                raise InvalidInput("--quiet and --verbose cannot be combined")
            set_loudness(quiet, verbose, ctx.info_name in _RESULTS)
            arguments = {p.name: values[p.name] for p in kept}
            command(**arguments, typed=Typed(ctx, values))

        called.__doc__ = command.__doc__
        parameters = [_CONTEXT, *kept, *action_parameters(actions, actions_hidden), *shared]
        called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {p.name: p.annotation for p in parameters}
        listed = _listed("Expert options:", _expert(experts, DEFAULTS | defaults))
        if actions_hidden:
            kinds = [(f"--{n} {KINDS[n].metavar}".rstrip(), KINDS[n].help) for n in actions]
            listed += ["", *_listed("Actions, applied before encoding, in the order given:", kinds)]
        called.epilog = "\n".join(listed)  # type: ignore[attr-defined]
        return called

    return decorate


#: Commands whose printed output is the result, which --quiet keeps.
_RESULTS = ("inspect", "compare", "run", "peers", "suite", "paper", "losses")

_CONTEXT = inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)


def _parameter(name: str, default: Any, hidden: bool) -> inspect.Parameter:
    """The command parameter of an option; if not typed, it is None or the default."""
    described = OPTIONS[name]
    kind: Any = list[str] if described.keys else described.kind
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=None if name == "cameras" else default,
        annotation=Annotated[
            kind if described.kind is bool else kind | None, typer_option(name, hidden)
        ],
    )


def is_given(ctx: typer.Context, name: str) -> bool:
    """Whether an option was typed, even with its default."""
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _expert(hidden: list[str], defaults: dict[str, Any]) -> list[tuple[str, str]]:
    """Expert options in their typed form, with their help."""
    entries = []
    for name in hidden:
        described, told = OPTIONS[name], OPTIONS[name].help
        default = described.shown or defaults.get(name)
        if default is not None and described.kind is not bool:
            told += f" (default: {default})"
        entries.append((f"{typed_name(name)} {metavar_of(described)}".rstrip(), told))
    return entries


def _listed(title: str, entries: list[tuple[str, str]]) -> list[str]:
    """Lines on options at the end of the help; empty without options."""
    column = 2 + max((len(head) for head, _ in entries), default=0)
    lines = [title] * bool(entries)
    for head, told in entries:
        first, *rest = textwrap.wrap(told, 78 - column)
        lines += [f"{head:<{column}}{first}", *(column * " " + line for line in rest)]
    return lines


#: Options of `Config` that also apply to other formats than `.egs`; and those for formats without
#: encoding.
_OF_ALL = ("extra", "nonfinite", "threads", "format")
_OF_STEPS = ("profile", "coarseness")


def config_of(typed: Typed, target: Path | None = None) -> Config:
    """The requested configuration, with the format of a target's suffix.

    Raises
    ------
    InvalidInput
        If an option is out of range, or has no effect.
    """
    form = _format_of(typed, target)
    if form in CODED_FORMATS and form != EGS:
        refuse_coding(typed, form, target)
    profile = Config(typed["profile"]).profile
    if profile not in PROFILES:
        typed.refuse(["preset"], f"uses {', '.join(PROFILES)}, not profile '{profile}'")
        why = f"has no effect on profile '{profile}', expected one of {', '.join(PROFILES)}"
        typed.refuse(("geometry", "tmc3", "verify", *PAPER_OPTIONS), why)
    return typed.build(Config, format=form if form in CODED_FORMATS else EGS)


def refuse_coding(typed: Typed, form: str, target: Path | None) -> None:
    """Reject coding options that have no effect on a format other than `.egs`."""
    settings: list[Any] = [Config]
    known = format_of(f".{form}")
    if known.writes == "floats":
        settings += [RateTarget, Steps]
        typed.refuse(["gt_images"], f"has no effect on {target or form}")
    used = (*_OF_ALL, *known.options, *(_OF_STEPS if known.writes == "steps" else ()))
    used = (*used, "max_memory") if known.in_parts else used
    names = [each.name or field for kind in settings for field, each in options_of(kind).items()]
    unused = [name for name in ("preset", "max_memory", *names) if name not in used]
    typed.refuse(unused, f"has no effect on {target or form}, expected an .egs")


def _format_of(typed: Typed, target: Path | None) -> str:
    """The format of a target's suffix, or of the option if it has no name; "" if unknown."""
    if target is None or is_stdout(target):
        return typed["format"] or EGS
    form = format_name(known_suffix(target))
    if form and typed["format"] not in (None, form):
        typed.refuse(["format"], f"has no effect on {target}, whose suffix sets the format")
    return form


#: Options for the size or quality of a file.
_TARGETS = ("target_size", "target_ratio", "target_bpg", "max_psnr_drop")


def target_of(typed: Typed) -> RateTarget | None:
    """The requested size or quality; None if there is none."""
    if any(typed[name] is not None for name in _TARGETS):
        return typed.build(RateTarget)
    typed.refuse(["allow_prune"], "needs a size or a quality, for example --target-ratio 30")
    return None


def plan_of(typed: Typed, config: Config) -> Plan | None:
    """The requested steps and views; None if there are none.

    Raises
    ------
    InvalidInput
        If an option has no effect in this combination.
    """
    if not typed["prune_geometry"]:
        typed.refuse(["geometry_rule"], "needs --prune-geometry")
    steps = typed.build(Steps)
    if not steps.refine:
        typed.refuse(["checkpoint"], "needs --refine, whose state it saves")
        typed.refuse(["device"], "needs --refine")
        typed.refuse(["keep_refined"], "needs --refine, whose result it keeps")
    if not steps.wanted and not _goes_by_views(typed, config):
        return None
    return typed.build(Plan, steps=steps)


def action_plan(typed: Typed) -> Plan | None:
    """The cameras that guide actions, if any were given.

    Raises
    ------
    InvalidInput
        If no action uses them.
    """
    guided = [action for action in typed.actions if KINDS[action.name].guided]
    if typed["cameras"] == "auto" and {action.name for action in guided} == {"remove-floaters"}:
        why = "'auto' has no effect on --remove-floaters, which needs cameras from a file"
        typed.refuse(["cameras"], why)
    if typed["cameras"] is None or not guided:
        known = ", ".join(f"--{name}" for name, kind in KINDS.items() if kind.guided)
        why = "has no effect without --cameras" if guided else f"needs one of {known}"
        typed.refuse(["cameras", "views", "width", "background"], why)
        return None
    return typed.build(Plan)


def _goes_by_views(typed: Typed, config: Config) -> bool:
    """Whether coding without preparation is camera-guided; rejects options without effect."""
    profile, measured = config.profile, typed["max_psnr_drop"] is not None
    if not measured:
        typed.refuse(["gt_images"], "needs --prune, --refine or --max-psnr-drop")
    if profile not in ADAPTIVE_PROFILES:
        known = ", ".join(ADAPTIVE_PROFILES)
        why = f"has no effect on profile '{profile}', expected {known}, --prune or --refine"
        typed.refuse(["cameras", "views", "width", "background"], why)
    # If step sizes cannot be chosen, a target prunes.
    fixed = config.scene_format.writes != "steps"
    prunes = fixed and any(typed[name] is not None for name in _TARGETS)
    if config.scene_format.is_exact and not prunes:
        why = f"has no effect on .{config.format}, whose values are exact: use --prune or --refine"
        typed.refuse(["cameras", "views", "width", "background"], why)
    if typed["cameras"] is not None or measured or typed["allow_prune"] or prunes:
        return True
    why = "has no effect without views, expected --cameras, --prune or --refine"
    typed.refuse(["views", "width", "background"], why)
    return False
