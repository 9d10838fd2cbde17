"""The user's choices of what to show."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

#: Names of the layers.
LAYERS = ("splats", "centres", "pruned", "boxes", "error", "octree")

#: Quantities that can colour centres.
COLOURINGS = ("colour", "opacity", "scale", "error", "bits", "sh", "class", "block")

#: Colour scales of quantities, and the default scale of each quantity that has one.
SCALES = ("linear", "log")
SCALED = {"opacity": "linear", "scale": "log", "error": "log", "bits": "linear", "sh": "log"}

#: Modes of showing two scenes.
MODES = ("side", "wipe", "flip")

#: Quantities that can colour octree cells, and the range of depths.
CELL_COLOURINGS = ("occupancy", "bits")
DEPTHS = range(1, 13)

#: Quantities with histograms.
QUANTITIES = (
    "opacity",
    "longest scale",
    "shortest scale",
    "red",
    "green",
    "blue",
    "SH band 1",
    "SH band 2",
    "SH band 3",
    "x",
    "y",
    "z",
)

#: Choices for the dock below the panes.
DOCKS = (
    "nothing",
    "PSNR of views",
    "views",
    "camera path",
    *(f"histogram: {name}" for name in QUANTITIES),
)


@dataclass(frozen=True)
class OctreeChoice:
    """Settings of the octree layer.

    Attributes
    ----------
    depth : int
        In `DEPTHS`.
    colouring : str
        One of `CELL_COLOURINGS`.
    filled : bool
        Whether cells are filled, not outlined.
    """

    depth: int = 6
    colouring: str = "occupancy"
    filled: bool = True

    def among(self, layers: Collection[str]) -> OctreeChoice:
        """The same for these layers: not filled if filled cells would hide splats or points."""
        return replace(self, filled=not set(layers) - {"octree", "boxes"})


@dataclass(frozen=True)
class Appearance:
    """How splats are drawn in panes and saved pictures; measurements ignore it.

    Attributes
    ----------
    sh_degree : int, 0-3
        Highest SH degree of their colours.
    scale : float, 0.05-2
        Factor for their axes.
    least_opacity : float, 0-1
        Minimum opacity of the splats and centres that are drawn.
    background : tuple of three float, 0-1
        RGB behind everything.
    """

    sh_degree: int = 3
    scale: float = 1.0
    least_opacity: float = 0.0
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class Choice:
    """All display settings.

    Attributes
    ----------
    layers : set of str
        Names in `LAYERS`.
    colouring : str
        One of `COLOURINGS`.
    scales : dict of str
        The scale of each of `SCALED`.
    mode : str
        One of `MODES`.
    front : {0, 1}
        Index of the scene that ``flip`` shows.
    wipe : float, 0-1
        Position of the wipe line.
    up : str
        Name of the up axis: one of `UPS`, or "cameras".
    octree : OctreeChoice
    exact : bool
        Whether gs_codec's rasteriser draws splats even with a graphics card.
    flying : bool
        Whether drags look around instead of orbiting the point ahead.
    dock : str
        Contents of the dock, one of `DOCKS`.
    appearance : Appearance
    """

    layers: set[str]
    colouring: str
    mode: str
    front: int = 1
    wipe: float = 0.5
    up: str = "-y"
    octree: OctreeChoice = field(default_factory=OctreeChoice)
    exact: bool = False
    flying: bool = False
    dock: str = "nothing"
    appearance: Appearance = field(default_factory=Appearance)
    scales: dict[str, str] = field(default_factory=SCALED.copy)

    @property
    def scale(self) -> str | None:
        """Scale of the chosen colouring, if it has one."""
        return self.scales.get(self.colouring)
