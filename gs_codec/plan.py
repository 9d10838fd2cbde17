"""Options of preparation: its steps, and the views that guide them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from gs_codec.config import check_options, option
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arguments import check_fields

if TYPE_CHECKING:
    from gs_codec.cameras.camera import Camera

#: Percentages below 100, so that something remains.
_PERCENT = {
    "kind": float,
    "metavar": "PERCENT",
    "low": 0,
    "high": math.nextafter(100, 0),
    "expected": "0 to below 100 percent",
    "percent": True,
}

#: Device for rendering and refinement.
Device = Literal["auto", "cpu", "cuda"]

#: Reference point of geometry pruning.
GeometryRule = Literal["median", "largest"]

_ITERATIONS = {"kind": int, "low": 0, "high": 10_000_000}

#: Value of `refine` for as many iterations as pay off.
AS_MANY_AS_PAY = -1

#: RGB of named colours.
BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}

CAMERAS = (
    "cameras.json, transforms.json, a camera path, a COLMAP folder, or auto (estimated from the "
    "scene)."
)


@dataclass(frozen=True)
class Steps:
    """Steps of preparation, all off by default; `pipeline` has the order they run in.

    Parameters
    ----------
    prune_geometry : float
        Percent of the Gaussians to remove along each axis, those farthest from the centre
        (theta2 of the paper, Section 4.2), 0 up to 100.
    geometry_rule : {"median", "largest"}
        Measure of distance: from the median of each axis or, as in the paper, absolute values
        (``largest``). Default ``median``, which does not depend on the origin.
    prune_importance : float
        Percent to remove by LightGaussian's importance (theta1 of the paper), 0 up to 100.
    prune : float, optional
        Percent to remove by leave-one-out error, 0 up to 100. By default none; with `refine` and no
        other pruning, as many as pay off compared with coarser steps; see `Balance`.
    gaussians : int, optional
        Maximum number of Gaussians; the rest is removed by leave-one-out error.
    prune_max_psnr_drop : float or None
        Stop leave-one-out pruning at this PSNR loss of rendered views, dB. Without `prune`, this is
        the only limit.
    refine : int
        Iterations of Adam on all attributes of the remaining Gaussians; -1 for as many as pay off:
        15 for each image that they fit, at least 2,000. If held-out views get
        worse, a warning says so and the result is that without `refine`, unless `keep_refined`.
    keep_refined : bool
        Keep the refined scene even if held-out views get worse, as the paper does; no effect
        without `refine`.
    compact_sh : float
        Strength of SH energy compaction, 0 and up: about the mean squared error of an image value
        (0-1) that it may add; 3e-5 is typical.
    refit_colour : int
        Conjugate-gradient iterations on the colours, SH-DC and SH-AC.
    rectify : float
        Clamp SH-AC to this many Laplace scales around their median, 0 to 1000; 0 disables it. Runs
        before `refine`, which adapts to it.

    Raises
    ------
    InvalidInput
        If a value is out of range.

    Examples
    --------
    >>> gs_codec.Steps(prune=30, refine=500).wanted
    True
    """

    prune_geometry: float = option(
        0.0, "Prune this percentage along each axis, farthest first (the paper's theta2).",
        **_PERCENT,
    )  # fmt: skip
    geometry_rule: GeometryRule = option(
        "median",
        "Centre of --prune-geometry: the median or, as in the paper, 0 (largest).",
        values=get_args(GeometryRule),
    )
    prune_importance: float = option(
        0.0, "Prune this percentage by LightGaussian's importance (the paper's theta1).", **_PERCENT
    )
    prune: float | None = option(
        None,
        "Prune this percentage of the Gaussians, those that change the views least.",
        shown="0; automatic with --refine",
        **_PERCENT,
    )
    gaussians: int | None = option(
        None,
        "Prune to this number of Gaussians, like --prune.",
        kind=int, low=1, high=1 << 40, expected="at least 1",
    )  # fmt: skip
    prune_max_psnr_drop: float | None = option(
        None,
        "Stop pruning at this PSNR loss, dB; without --prune, it is the only limit.",
        kind=float, metavar="DB", low=0, high=100, expected="0 to 100 dB",
    )  # fmt: skip
    refine: int = option(
        0,
        "Refine all attributes with N iterations of Adam (without N, as many as pay off).",
        metavar="[N]", shown="none", alone=AS_MANY_AS_PAY, **(_ITERATIONS | {"low": -1}),
    )  # fmt: skip
    keep_refined: bool = option(
        False,
        "Keep the refined scene even if held-out views get worse, as the paper does.",
        kind=bool,
    )
    compact_sh: float = option(
        0.0,
        "Move SH energy to fewer coefficients; 3e-5 is typical.",
        kind=float, metavar="STRENGTH", low=0, high=1e6, expected="a strength of 0 or more",
    )  # fmt: skip
    refit_colour: int = option(0, "Refit SH with N conjugate-gradient iterations.", **_ITERATIONS)
    rectify: float = option(
        0.0,
        "Move SH-AC to within N Laplace scales of their median.",
        kind=float, metavar="N", low=0, high=1000, expected="0 to 1000",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_fields(self)
        check_options(self)
        if self.geometry_rule != "median" and not self.prune_geometry:
            raise InvalidInput("geometry_rule: needs prune_geometry")
        if self.prune is not None and 0 < self.prune < 1:
            raise InvalidInput(f"prune {self.prune}: expected percent, such as 50 for half")
        if self.prune is not None and self.gaussians is not None:
            raise InvalidInput(
                "gaussians and prune cannot be combined: both set the number of Gaussians"
            )

    @property
    def wanted(self) -> bool:
        """Whether there is anything to do."""
        return replace(self, prune=self.prune or None, keep_refined=False) != Steps()

    @property
    def by_leave_one_out(self) -> bool:
        """Whether Gaussians are removed by leave-one-out error."""
        limited = self.gaussians is not None or self.prune_max_psnr_drop is not None
        return bool(self.prune) or limited or self.balanced

    @property
    def balanced(self) -> bool:
        """Whether pruning stops when it no longer pays off: no amount given, then refinement."""
        limits = (self.prune, self.gaussians, self.prune_max_psnr_drop)
        prunes = self.prune_geometry or self.prune_importance or any(x is not None for x in limits)
        return self.refine != 0 and not prunes


@dataclass(frozen=True)
class Plan:
    """Steps of preparation, and the views that guide them.

    Parameters
    ----------
    steps : Steps
        Which steps to run; none by default.
    cameras : path, "auto", or sequence of Camera
        Cameras marked ``test`` measure quality; at most `views` of the others, evenly spaced, guide
        the steps, together with views between them if there are fewer. If none or all are marked,
        the same cameras do both, but with `refine`, or a target that is a loss or may prune, every
        8th only measures. ``auto`` estimates two to four times `views` cameras, with as many pixels
        in total as `views` images of 420 x 280.
    gt_images : path, optional
        Folder of the cameras' ground-truth images; some may be missing. Quality and losses are
        measured against them. `refine` fits them, renders of the input for cameras without one,
        and at most a third as many renders between cameras. By default renders of the input are
        used. Images with lens distortion are undistorted (see `Lens`); sides of those with more
        than 4 megapixels are divided by 2, 3, ...
    width : int, optional
        Width of the views, pixels; not allowed with `gt_images`, whose size is used. By default
        that of the cameras, or less where a view would have more than 4 megapixels.
    views : int
        Maximum number of guiding views, 1 or more. `refine` fits up to four times as many.
    background : tuple of three float
        RGB behind the scene, and behind transparent parts of ground-truth images, 0-1.
    checkpoint : path, optional
        File to which `refine` saves its state, and from which it resumes.
    device : {"auto", "cpu", "cuda"}
        Device for `refine`: ``cuda`` uses gsplat, ``auto`` uses ``cuda`` if available. Results on a
        device vary slightly from run to run; the other steps run on the CPU.
    holds_out : bool
        Whether every 8th camera only measures, if none or all are marked.

    Raises
    ------
    InvalidInput
        If there are both ground-truth images and a width, no views, or the background is not three
        finite numbers.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> plan.views
    64
    """

    steps: Steps = Steps()
    cameras: str | Path | Sequence[Camera] = option(
        "auto", f"Reference views: {CAMERAS}", metavar="C", shown="auto, if views are needed"
    )
    gt_images: str | Path | None = option(
        None,
        "Folder of ground-truth images, used instead of renders of the input.",
        kind=Path, metavar="DIR",
    )  # fmt: skip
    width: int | None = option(
        None,
        "Width of the views, pixels.",
        kind=int,
        low=1,
        high=1 << 20,
        shown="the cameras' width; if they guide, at most 4 megapixels",
    )
    views: int = option(
        64,
        "Maximum number of views; if estimated, or for refinement, up to four times as many.",
        kind=int,
        low=1,
        high=1 << 30,
        expected="at least 1",
    )
    background: tuple[float, float, float] = option(
        BACKGROUNDS["black"], "Background colour.", shown="black", values=BACKGROUNDS
    )
    checkpoint: str | Path | None = option(
        None,
        "File that saves and resumes --refine.",
        kind=Path, metavar="FILE",
    )  # fmt: skip
    device: Device = option(
        "cpu",
        "Device for rendering and refinement; cuda needs gsplat, auto uses cuda if possible.",
        values=get_args(Device),
    )

    holds_out: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.gt_images is not None and self.width is not None:
            raise InvalidInput("width: cannot be combined with ground-truth images, which set it")
        check_options(self)
        from gs_codec.runtime.arrays import finite  # NumPy is not needed for help

        finite("background", self.background, 3)

    @property
    def estimates(self) -> bool:
        """Whether cameras are estimated from the scene."""
        return isinstance(self.cameras, str | Path) and str(self.cameras) == "auto"
