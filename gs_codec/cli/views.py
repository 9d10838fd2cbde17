"""Options that ``render`` and ``compare`` share."""

from __future__ import annotations

from typing import Annotated

import typer

from gs_codec.errors import InvalidInput

#: RGB by the name `--background` takes.
_BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}

_DEVICES = ("auto", "cpu", "cuda")

CAMERAS = "cameras.json, a COLMAP model's folder, or auto: views chosen from the scene itself."
SPLIT = "Cameras to use: all, test, train, or held-out (test where they are marked, else all)."

Width = Annotated[
    int | None, typer.Option(help="Width of the images, pixels.", show_default="the cameras'")
]
Background = Annotated[str, typer.Option(help="Behind the scene: black or white.")]
Device = Annotated[
    str, typer.Option(help="Draw on cpu, on cuda with gsplat, or auto: cuda where possible.")
]


def drawing_options(background: str, device: str) -> dict:
    """RGB of ``--background`` and the name of ``--device``, checked."""
    if background not in _BACKGROUNDS:
        raise InvalidInput(f"--background {background}: expected {' or '.join(_BACKGROUNDS)}")
    if device not in _DEVICES:
        raise InvalidInput(f"--device {device}: expected one of {', '.join(_DEVICES)}")
    return {"background": _BACKGROUNDS[background], "device": device}
