"""Centres of Gaussians, coloured by a quantity on a scale shared by all scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.neighbours import Neighbours
from viewer.pictures.layers import (
    SELECTED,
    UNKNOWN,
    Legend,
    Points,
    block_colour,
    error_heat,
    error_legend,
    heat,
    legend_of,
    reason_colour,
)
from viewer.pictures.ticks import scale_marks
from viewer.scenes.appearance import Look, which_drawn
from viewer.scenes.choice import SCALED
from viewer.scenes.opened import Opened, Pruned, thinned

#: Maximum error of the linear scale; equal to that of `error_heat`.
_LARGEST_ERROR = 64 / 255

#: Selection of the Gaussians to show.
Some = slice | NDArray[np.int64]

#: All Gaussians are drawn.
_PLAIN = Look()

#: Maximum number of classes in a legend.
KINDS = 8


@dataclass(frozen=True)
class _Magnitude:
    """A non-negative quantity of Gaussians.

    Values at the `quantiles` get about the first and last colour. Without them, `least` and 1 do on
    a logarithmic scale, 0 and 1 on a linear one.
    """

    title: str
    values: Callable[[Opened], NDArray | None]
    quantiles: tuple[float, float] | None = None
    least: float = 0.0

    def range(self, scenes: Sequence[Opened], scale: str) -> tuple[float, float]:
        """Values of about the first and last colour, over all scenes."""
        if self.quantiles is None:
            return (0.0 if scale == "linear" else self.least), 1.0
        known = [each for each in map(self.values, scenes) if each is not None]
        every = np.concatenate(known)
        every = every[np.isfinite(every) & ((every > 0) | (scale == "linear"))]
        if not len(every):
            return (0.0 if scale == "linear" else 1.0), 1.0
        low, high = np.quantile(every, self.quantiles).tolist()
        return low, high


_MAGNITUDES = {
    "opacity": _Magnitude("opacity", lambda scene: scene.opacities, least=1e-4),
    "scale": _Magnitude("longest axis, scene units", lambda scene: scene.lengths, (0.01, 0.99)),
    "bits": _Magnitude("bits / Gaussian", lambda scene: scene.bits, (0.02, 0.98)),
    "sh": _Magnitude("SH energy (sum of squares)", lambda scene: scene.sh_energy, (0.02, 0.98)),
}


def centres(
    scene: Opened,
    colouring: str,
    scenes: Sequence[Opened],
    most: int | None = None,
    scale: str | None = None,
    look: Look = _PLAIN,
) -> Points:
    """Centres of the drawn Gaussians of a scene, at most `most`, with colours.

    Parameters
    ----------
    scene : Opened
    colouring : str
        One of `COLOURINGS`: SH-DC; opacity; the longest axis; the colour difference from the
        nearest centre of the other scene; bits; the sum of squares of SH-AC; the class of shape;
        the block number. Grey if `why_unknown` returns a reason.
    scenes : sequence of Opened
        All scenes shown; they share one range.
    most : int, optional
    scale : {"linear", "log"}, optional
        Default: see `SCALED`.
    look : Look
    """
    some = _some(scene, most or scene.count, look)
    positions = scene.positions[some]
    if colouring == "colour":
        return Points(positions, scene.colours[some])
    if why_unknown(scene, colouring, scenes):
        return Points(positions, np.full((len(positions), 3), UNKNOWN, np.float32))
    known = [each for each in scenes if not why_unknown(each, colouring, scenes)]
    if colouring == "error":
        other = next(each for each in scenes if each is not scene)
        colours, legend = _by_error(colour_errors(scene, other, some), scale or SCALED["error"])
    elif colouring == "class":
        colours, legend = _by_class(scene, known, some)
    elif colouring == "block":
        colours, legend = _by_block(scene, known, some)
    else:
        magnitude = _MAGNITUDES[colouring]
        values = magnitude.values(scene)
        assert values is not None
        colours, legend = _by_magnitude(magnitude, values[some], known, scale or SCALED[colouring])
    return Points(positions, colours, legend)


def _some(scene: Opened, most: int, look: Look) -> Some:
    """Indices of the centres to show."""
    mask = which_drawn(scene, look)
    if mask is None:
        return thinned(scene.count, most)
    drawn = np.flatnonzero(mask)
    return drawn[thinned(len(drawn), most)]


def why_unknown(scene: Opened, colouring: str, scenes: Sequence[Opened]) -> str:
    """Why centres of a scene cannot have this colouring; empty if they can."""
    if colouring == "error":
        return "" if len(scenes) > 1 else "there is no other scene"
    return scene.unknown(colouring)


def _by_magnitude(
    magnitude: _Magnitude, values: NDArray, known: Sequence[Opened], scale: str
) -> tuple[NDArray[np.float32], Legend]:
    marks = scale_marks(*magnitude.range(known, scale), scale)
    if scale == "linear":
        return heat(values, marks[0], marks[-1]), legend_of(magnitude.title, marks)
    with np.errstate(divide="ignore"):
        colours = heat(np.log(values), *np.log(marks[[0, -1]]))
    return colours, legend_of(magnitude.title, marks)


def _by_error(errors: NDArray, scale: str) -> tuple[NDArray[np.float32], Legend]:
    if scale == "log":
        return error_heat(errors), error_legend("colour error")
    marks = np.linspace(0, 255 * _LARGEST_ERROR, 5)
    return heat(errors, 0, _LARGEST_ERROR), legend_of("colour error, of 255", marks)


def _by_class(
    scene: Opened, known: Sequence[Opened], some: Some
) -> tuple[NDArray[np.float32], Legend]:
    """Colours by the class of shape, a multiple of 4 from 0."""
    classes = [each.classes[0] for each in known if each.classes is not None]
    most = max(4 * -(-int(own.max(initial=0)) // 4) for own in classes) or 4
    assert scene.classes is not None
    title = "class of shape: octaves of step size"
    return heat(scene.classes[0][some], 0, most), legend_of(title, np.linspace(0, most, 5))


def _by_block(
    scene: Opened, known: Sequence[Opened], some: Some
) -> tuple[NDArray[np.float32], Legend]:
    most = max(each.block_numbers[-1] + 1 for each in known if each.block_numbers is not None)
    palette = np.array([block_colour(k) for k in range(most)], np.float32)
    listed = range(min(most, KINDS))
    title = f"block, of {most}" if most <= KINDS else f"block, of {most}: the first {KINDS}"
    legend = Legend(title, tuple(map(str, listed)), tuple(map(block_colour, listed)))
    assert scene.block_numbers is not None
    return palette[scene.block_numbers[some]], legend


def colour_errors(scene: Opened, reference: Opened, some: Some) -> NDArray[np.float32]:
    """Root-mean-square difference over RGB from the SH-DC colour of the nearest centre."""
    colours = scene.colours[some]
    if not reference.count:
        return np.zeros(len(colours), np.float32)
    finite = np.isfinite(reference.positions).all(axis=1)
    positions = np.nan_to_num(scene.positions[some])
    _, nearest = Neighbours(reference.positions[finite]).nearest(positions, 1)
    known = reference.colours[finite][nearest[:, 0]]
    return np.sqrt(np.mean((colours - known) ** 2, axis=1))


def pruned_centres(scene: Opened, pruned: Pruned, most: int | None = None) -> Points:
    """Pruned Gaussians, at most `most`, coloured by reason."""
    labels = pruned.of(scene).labels
    gone = np.flatnonzero(labels)
    gone = gone[thinned(len(gone), most or len(gone))]
    palette = np.array([reason_colour(k) for k in range(max(len(pruned.reasons), 1))], np.float32)
    return Points(scene.positions[gone], palette[labels[gone] - 1])


def selected_centres(scene: Opened, selected: NDArray[np.bool_], most: int) -> Points:
    """Centres of the selected Gaussians ``(N,)``, at most `most`, in colour `SELECTED`."""
    rows = np.flatnonzero(selected)
    rows = rows[thinned(len(rows), most)]
    return Points(scene.positions[rows], np.full((len(rows), 3), SELECTED, np.float32))
