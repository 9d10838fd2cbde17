"""The result of `compare`, and its table."""

from __future__ import annotations

from dataclasses import dataclass

from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.metrics.image_quality import Quality, View, mean_quality
from gs_codec.pages.tables import Table


@dataclass(frozen=True)
class GroupError:
    """Errors of one attribute, over all its components.

    Attributes
    ----------
    name : str
        The attribute, ``scaling`` for log-scales.
    unit : str
        Unit of both errors: ``scene units``, ``SH``, ``logit``, ``0-1``, ``log``, ``stored``
        (components of quaternions) or ``degrees``.
    max : float
        Maximum absolute error.
    rms : float
        Root mean square.

    Examples
    --------
    >>> errors = gs_codec.compare("scene.ply", "scene.egs").groups
    >>> [group.unit for group in errors if group.name == "opacity"]
    ['logit', '0-1']
    >>> all(group.rms <= group.max for group in errors)
    True
    """

    name: str
    unit: str
    max: float
    rms: float


@dataclass(frozen=True)
class Comparison:
    """Comparison of two scenes: errors by attribute, or of rendered views.

    Attributes
    ----------
    counts : tuple of two int
        Number of Gaussians of each scene.
    matched_by : str or None
        ``stored order``, ``index``, ``Morton order`` or ``nearest centre``; None with cameras,
        which need no matching.
    groups : tuple of GroupError
        Errors by attribute, empty with cameras. Opacity and rotation appear twice, in two
        units.
    views : tuple of View
        Comparison of each view, in the cameras' order; empty without cameras.
    systems : tuple of two str
        Coordinate systems of the two files; if they differ, one scene was converted.
    backbone : str or None
        Network used for LPIPS; values of different networks are not comparable. None if LPIPS was
        not measured.

    Examples
    --------
    >>> seen = gs_codec.compare("scene.ply", "scene.egs", "cameras.json", width=48)
    >>> seen.counts, len(seen.views), seen.worst.between.psnr <= seen.mean.between.psnr
    ((2000, 2000), 2, True)
    """

    counts: tuple[int, int]
    matched_by: str | None = None
    groups: tuple[GroupError, ...] = ()
    views: tuple[View, ...] = ()
    systems: tuple[str, str] = (CONVENTION, CONVENTION)
    backbone: str | None = None

    @property
    def mean(self) -> View:
        """Means over the views.

        Raises
        ------
        InvalidInput
            If there are no views.
        """
        self._check_views()
        between = mean_quality([view.between for view in self.views])
        first = [view.first for view in self.views if view.first]
        second = [view.second for view in self.views if view.second]
        if not (first and second):
            return View("mean", between)
        return View("mean", between, mean_quality(first), mean_quality(second))

    @property
    def worst(self) -> View:
        """The view with the lowest PSNR between the scenes; the first if there are several.

        Raises
        ------
        InvalidInput
            If there are no views.
        """
        self._check_views()
        return min(self.views, key=lambda view: view.between.psnr)

    def _repr_html_(self) -> str:
        """A table, for notebooks."""
        return table_of(self).html("Gaussians: {:,} in A, {:,} in B".format(*self.counts))

    def _check_views(self) -> None:
        if not self.views:
            raise InvalidInput("comparison: made without cameras, so there are no views")


def table_of(comparison: Comparison) -> Table:
    """The views, with their mean and the worst; without cameras, the errors by attribute."""
    if comparison.views:
        return _views(comparison)
    rows = [[g.name, g.unit, f"{g.max:.6g}", f"{g.rms:.6g}"] for g in comparison.groups]
    return Table(["attribute", "unit", "max error", "rms error"], rows)


def _views(comparison: Comparison) -> Table:
    mean, worst = comparison.mean, comparison.worst
    with_truth, with_lpips = mean.delta is not None, mean.between.lpips is not None
    columns = ["view", "PSNR dB", "SSIM"] + [f"LPIPS ({comparison.backbone})"] * with_lpips
    if with_truth:
        columns += ["A to truth", "B to truth", "delta-PSNR", "delta-SSIM"]
        columns += ["delta-LPIPS"] * with_lpips
    rows = [_row(view.name, view) for view in comparison.views]
    equal = sum(view.between.psnr == float("inf") for view in comparison.views)
    name = f"mean (PSNR without {equal} equal)" if 0 < equal < len(comparison.views) else "mean"
    rows += [_row(name, mean), _row(f"worst: {worst.name}", worst)]
    return Table(columns, rows)


def _row(name: str, view: View) -> list[str]:
    row = [name, *_numbers(view.between, "")]
    if view.first and view.second and view.delta:
        row += [f"{view.first.psnr:.3f}", f"{view.second.psnr:.3f}", *_numbers(view.delta, "+")]
    return row


def _numbers(quality: Quality, sign: str) -> list[str]:
    values = [f"{quality.psnr:{sign}.3f}", f"{quality.ssim:{sign}.5f}"]
    return values if quality.lpips is None else [*values, f"{quality.lpips:{sign}.5f}"]
