"""The user's choices of what to show."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

#: Layers that can be switched on and off.
LAYERS = ("splats", "centres", "pruned", "boxes", "error", "octree")

#: Quantities that centres can be coloured by.
COLOURINGS = ("colour", "opacity", "scale", "error", "bits", "sh", "class", "block")

#: Scales of the colours of magnitudes; those that have them, and which they have by default.
SCALES = ("linear", "log")
SCALED = {"opacity": "linear", "scale": "log", "error": "log", "bits": "linear", "sh": "log"}

#: How two scenes are shown.
MODES = ("side", "wipe", "flip")

#: Quantities that cells of the octree can be coloured by, and the depths they can have.
CELL_COLOURINGS = ("occupancy", "bits")
DEPTHS = range(1, 13)

#: Quantities whose histograms are shown below the panes.
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

#: What is shown below the panes.
DOCKS = ("nothing", "PSNR of views", "views", *(f"histogram: {name}" for name in QUANTITIES))


@dataclass(frozen=True)
class OctreeChoice:
    """How the octree is shown.

    Attributes
    ----------
    depth : int
        In `DEPTHS`.
    colouring : str
        One of `CELL_COLOURINGS`.
    filled : bool
        Whether cells are filled; otherwise only their edges are drawn.
    """

    depth: int = 6
    colouring: str = "occupancy"
    filled: bool = True

    def among(self, layers: Collection[str]) -> OctreeChoice:
        """The same among layers: filled cells would hide splats and points."""
        return replace(self, filled=not set(layers) - {"octree", "boxes"})


@dataclass(frozen=True)
class Appearance:
    """How splats are drawn in panes and saved pictures; what is measured does not depend on it.

    Attributes
    ----------
    sh_degree : int, 0-3
        Highest SH degree of their colours.
    scale : float, 0.05-2
        Factor on their axes.
    least_opacity : float, 0-1
        Gaussians of lower opacity are not drawn, neither as splats nor as centres.
    background : tuple of three float, 0-1
        RGB behind everything.
    """

    sh_degree: int = 3
    scale: float = 1.0
    least_opacity: float = 0.0
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class Choice:
    """What is shown of the scenes, and how.

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
        Which scene ``flip`` shows.
    wipe : float, 0-1
        Position of the line of ``wipe``.
    up : str
        Name of the up axis, in `UPS` or "cameras".
    octree : OctreeChoice
    exact : bool
        Whether a graphics card leaves splats to gs_codec's rasteriser.
    flying : bool
        Whether a drag looks around instead of turning about the point ahead.
    dock : str
        What is shown below the panes, of `DOCKS`.
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
        """The scale of the colouring, if it has one."""
        return self.scales.get(self.colouring)
