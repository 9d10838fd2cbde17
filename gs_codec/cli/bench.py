"""``gs-codec bench``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gs_codec.cli import bench_modes, bench_scaling, bench_suite
from gs_codec.cli.coding import parse_depths
from gs_codec.cli.given import is_given, refuse_given
from gs_codec.cli.resources import MaxMemory, Overwrite, Threads
from gs_codec.cli.views import CAMERAS, Width
from gs_codec.config import LATTICE_PROFILES, PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput
from gs_codec.io.atomic import check_writable

#: Options that some modes have no use for.
_OPTIONS = (
    "profile", "depth", "tile", "repeats", "cameras", "against_gt", "width", "coders", "max_memory",
    "plot", "extra", "overwrite",
)  # fmt: skip

_VIEWS = ("cameras", "against_gt", "width")

#: What each mode uses of them; without a mode, profiles are measured one by one.
_USED: dict[str, tuple[str, ...]] = {
    "": ("profile", "depth", "tile", "repeats", *_VIEWS, "coders", "extra"),
    "prepare": ("profile", "depth", "tile", *_VIEWS, "plot", "extra", "overwrite"),
    "gains": ("tile", *_VIEWS, "extra"),
    "targets": ("tile", *_VIEWS, "plot", "extra", "overwrite"),
    "parts": ("profile", "depth", "tile", "cameras", "width", "extra"),
    "points": ("profile", "depth", "tile", "repeats", "extra"),
    "peers": ("profile", "depth", "tile", "repeats", *_VIEWS, "extra"),
    "start": ("repeats", "extra"),
    "stress": ("profile",),
    "scaling": ("profile", "max_memory", "plot", "overwrite"),
}

_BY_CAMERAS = ("prepare", "gains", "targets", "parts")


def command(
    ctx: typer.Context,
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SCENE...", help="3DGS .ply files.", show_default=False),
    ] = None,
    profile: Annotated[
        list[str] | None, typer.Option("--profile", "-p", help="Profiles; all when not given.")
    ] = None,
    depth: Annotated[
        list[str] | None, typer.Option(metavar="GROUP=BITS", help="As for encode.")
    ] = None,
    tile: Annotated[
        int | None,
        typer.Option(help="Tile each scene, jittered, to this many Gaussians.", min=1),
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs; medians are reported.", min=1)] = 5,
    threads: Threads = None,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Measure rendered quality too: {CAMERAS}")
    ] = None,
    against_gt: Annotated[
        Path | None,
        typer.Option(metavar="IMAGES", help="Ground-truth images of these cameras."),
    ] = None,
    width: Width = None,
    coders: Annotated[
        bool, typer.Option("--coders", help="Compare torchac and constriction too (a minute).")
    ] = False,
    peers: Annotated[
        bool,
        typer.Option("--peers", help="Measure spz, splat-transform, pcodec, zstd beside instead."),
    ] = False,
    gains: Annotated[
        bool,
        typer.Option("--gains", help="Measure l, m, s over paper-* at equal quality instead."),
    ] = False,
    parts: Annotated[
        bool, typer.Option("--parts", help="Measure what each part of l, m, s saves instead.")
    ] = False,
    targets: Annotated[
        bool,
        typer.Option(
            "--targets", help="Measure wanted sizes and qualities beside l, m, s instead."
        ),
    ] = False,
    points: Annotated[
        bool,
        typer.Option("--points", help="Measure octree and G-PCC on geometry and SH-DC instead."),
    ] = False,
    prepare: Annotated[
        bool, typer.Option("--prepare", help="Measure preparation instead (ten minutes or so).")
    ] = False,
    start: Annotated[
        bool, typer.Option("--start", help="Measure how long each command takes to start instead.")
    ] = False,
    stress: Annotated[
        bool, typer.Option("--stress", help="Measure scenes that try the numbers instead.")
    ] = False,
    scaling: Annotated[
        bool,
        typer.Option("--scaling", help="Measure how time and memory grow with scenes instead."),
    ] = False,
    max_memory: MaxMemory = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="With --prepare, --targets or --scaling: plot it."),
    ] = None,
    extra: Annotated[str, typer.Option(help="As for encode.")] = "error",
    overwrite: Overwrite = False,
) -> None:
    """Measure time, size, error, memory and rendered quality; JSON lines on stdout.

    `bench suite` measures all there is to measure; a scene of that name is ./suite.
    """
    mode = _mode_of(
        prepare=prepare, gains=gains, targets=targets, parts=parts, points=points, peers=peers,
        scaling=scaling, start=start, stress=stress,
    )  # fmt: skip
    scenes = scenes or []
    _check_scenes(mode, bool(scenes))
    _check_options(ctx, mode, profile)
    if plot is not None:
        check_writable(plot, overwrite)
    configs = [
        Config(name, parse_depths(depth or []), "error", extra, threads)  # type: ignore[arg-type]
        for name in profile or PROFILE_CHOICES
    ]
    views = (cameras, against_gt, width)

    def chosen(name: str) -> list[Config]:
        """The profiles that were given, or this one."""
        return configs if profile else [replace(configs[0], profile=name)]

    runs: dict[str, Callable[[], None]] = {
        "": lambda: bench_modes.run_profiles(
            scenes, configs, tile, repeats, coders, threads, views
        ),
        "prepare": lambda: bench_modes.run_preparation(scenes, configs, tile, views, plot),
        "gains": lambda: bench_modes.run_gains(scenes, configs[0], tile, views),
        "targets": lambda: bench_modes.run_targets(scenes, configs[0], tile, views, plot),
        "parts": lambda: bench_modes.run_parts(scenes, chosen("m"), tile, views),
        "points": lambda: bench_modes.run_points(scenes, chosen("paper-m"), tile, repeats),
        "peers": lambda: bench_modes.run_peers(scenes, configs, tile, repeats, views),
        "start": lambda: bench_modes.run_start(scenes, configs[0], repeats),
        "stress": lambda: bench_modes.run_stress(profile or list(PROFILE_CHOICES), threads),
        "scaling": lambda: bench_scaling.measure(
            scenes, profile or ["m"], threads, max_memory, plot
        ),
    }
    runs[mode]()


def _mode_of(**asked: bool) -> str:
    """What is measured instead of profiles one by one; empty if it is these."""
    modes = [name for name, wanted in asked.items() if wanted]
    if len(modes) > 1:
        raise InvalidInput(f"--{modes[0]} and --{modes[1]}: one at a time")
    return modes[0] if modes else ""


def _check_options(ctx: typer.Context, mode: str, profiles: list[str] | None) -> None:
    """Refuse what a mode has no use for, or cannot do without."""
    for name in _OPTIONS:
        if name not in _USED[mode]:
            modes = " or ".join(f"--{other}" for other in _USED if other and name in _USED[other])
            why = f"has no effect beside --{mode}" if mode else f"needs {modes}"
            refuse_given(ctx, [name], why)
    if mode in _BY_CAMERAS and not is_given(ctx, "cameras"):
        raise InvalidInput(f"--{mode} needs --cameras")
    if not is_given(ctx, "cameras"):
        refuse_given(ctx, ("against_gt", "width"), "needs --cameras")
    if not is_given(ctx, "plot"):
        refuse_given(ctx, ["overwrite"], "needs --plot")
    if mode == "parts" and not set(profiles or ["m"]) <= set(LATTICE_PROFILES):
        raise InvalidInput("--parts needs profiles l, m or s; m when none is given")


def _check_scenes(mode: str, given: bool) -> None:
    """Refuse scenes beside those that --stress has, or none at all."""
    if mode == "stress" and given:
        raise InvalidInput("--stress takes no scenes: it has its own")
    if mode != "stress" and not given:
        raise InvalidInput("no scenes given, expected SCENE... or --stress")


class _Group(TyperGroup):
    """The suite, when its name comes first; else scenes, and what to measure of them."""

    def make_context(
        self, info_name: Any, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """As click's: what a command line says, and the command that it is of."""
        if args[:1] != ["suite"]:
            return super().make_context(info_name, args, parent, **extra)
        return self.commands["suite"].make_context(f"{info_name} suite", args[1:], parent, **extra)


app = typer.Typer(
    cls=_Group,
    invoke_without_command=True,
    subcommand_metavar="| suite [OPTIONS] [SCENE...]",
    context_settings={"allow_interspersed_args": True},
    add_completion=False,
)
app.callback()(command)
app.command("suite")(bench_suite.command)
