"""What a person has chosen to see."""

from __future__ import annotations

from dataclasses import dataclass

#: How two scenes are shown.
MODES = ("side", "wipe", "flip")


@dataclass
class Choice:
    """What is shown of the scenes, and how.

    Attributes
    ----------
    layers : set of str
        Of `LAYERS`.
    colouring : str
        Of `COLOURINGS`.
    mode : str
        Of `MODES`.
    front : {0, 1}
        Which scene ``flip`` shows.
    place : float, 0-1
        Where ``wipe`` divides the view.
    up : str
        Which axis is up, of `UPS`.
    """

    layers: set[str]
    colouring: str
    mode: str
    front: int = 1
    place: float = 0.5
    up: str = "-y"
