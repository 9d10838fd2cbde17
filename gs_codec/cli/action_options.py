"""Actions as command-line options, in the order typed."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import partial
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from gs_codec.cli.command import Shown
from gs_codec.cli.output import print_status
from gs_codec.edit.actions import KINDS, Action
from gs_codec.report import ActionReport
from gs_codec.runtime.wording import counted

#: Prefix of command parameters for actions, because preparation has options of the same names.
_PREFIX = "do_"

_PANEL = "Actions, applied in the order given"


class InOrder(Shown, TyperCommand):
    """A command that records the order of its parameters, for `typed_actions`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and record the names of parameters in the order typed, with repetitions."""
        _, _, order = self.make_parser(ctx).parse_args(list(args))
        ctx.meta[_PREFIX] = [param.name for param in order]
        return super().parse_args(ctx, args)


def action_parameters(names: Iterable[str], hidden: bool) -> list[inspect.Parameter]:
    """Command parameters for actions; `hidden` ones are listed only in the help of `convert`."""
    return [_parameter(name, hidden) for name in names]


def _parameter(name: str, hidden: bool) -> inspect.Parameter:
    kind = KINDS[name]
    typed: Any = list[str] | None if kind.metavar else bool
    option = typer.Option(
        f"--{name}",
        help=kind.help,
        metavar=kind.metavar,
        parser=partial(Action, name) if kind.metavar else None,
        rich_help_panel=_PANEL,
        hidden=hidden,
        show_default=False,
    )
    return inspect.Parameter(
        _parameter_of(name),
        inspect.Parameter.KEYWORD_ONLY,
        default=None if kind.metavar else False,
        annotation=Annotated[typed, option],
    )


def typed_actions(ctx: typer.Context, values: dict[str, Any]) -> list[Action]:
    """The actions among the values of a command's parameters, in the order typed."""
    switches = {_parameter_of(name): name for name, kind in KINDS.items() if not kind.metavar}
    waiting = {
        parameter: iter(values.get(parameter) or ())
        for parameter in map(_parameter_of, KINDS)
        if parameter not in switches
    }
    return [
        Action(switches[parameter]) if parameter in switches else next(waiting[parameter])
        for parameter in ctx.meta.get(_PREFIX, ())
        if parameter in switches or parameter in waiting
    ]


def _parameter_of(name: str) -> str:
    return _PREFIX + name.replace("-", "_")


def say_what_was_done(actions: Iterable[ActionReport]) -> None:
    """Print a line on stderr for each action that selects Gaussians."""
    for done in actions:
        if KINDS[done.action.partition(" ")[0]].does != "choose":
            continue
        reasons = ", ".join(f"{reason} {count:,}" for reason, count in done.details.items())
        listed = f" ({reasons})" if reasons else ""
        gone = done.before - done.after
        print_status(
            f"{done.action}: removed {gone:,} of {counted(done.before, 'Gaussian')}{listed}"
        )
