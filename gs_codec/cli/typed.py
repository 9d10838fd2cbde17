"""The typed options of a command."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, TypeVar

import typer

from gs_codec.cli.action_options import action_parameters, typed_actions
from gs_codec.cli.documents import keep_off_stdout
from gs_codec.cli.options import DEFAULTS, OPTIONS, metavar_of, typed_name, typer_option
from gs_codec.cli.output import set_loudness
from gs_codec.cli.streams import is_stdout
from gs_codec.config import Config, RateTarget, options_of
from gs_codec.edit.actions import KINDS
from gs_codec.errors import InvalidInput
from gs_codec.plan import Plan, Steps
from gs_codec.presets import PRESETS

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

        Raises InvalidInput if one was typed; `why` states what it needs.
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
            keep_off_stdout(is_stdout(values.get("target")))
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
            kind if described.kind is bool else kind | None,
            typer_option(name, hidden, default != DEFAULTS.get(name)),
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
        described, shown = OPTIONS[name], OPTIONS[name].help
        default = described.shown or defaults.get(name)
        if default is not None and described.kind is not bool:
            shown += f" (default: {default})"
        entries.append((f"{typed_name(name)} {metavar_of(described)}".rstrip(), shown))
    return entries


def _listed(title: str, entries: list[tuple[str, str]]) -> list[str]:
    """Lines on options at the end of the help; empty without options."""
    column = 2 + max((len(head) for head, _ in entries), default=0)
    lines = [title] * bool(entries)
    for head, shown in entries:
        first, *rest = textwrap.wrap(shown, 78 - column)
        lines += [f"{head:<{column}}{first}", *(column * " " + line for line in rest)]
    return lines
