"""Find the Gaussian shown at a pixel, and collect all information about it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.inria import as_camera
from gs_codec.codecs.gaussian_costs import CodedGaussian
from gs_codec.files.scenes import describe_gaussian_of_file
from gs_codec.rendering.pixel import gaussian_weight, pixel_weights
from gs_codec.scene import sh_bands
from viewer.scenes.appearance import Look, gaussians_drawn, which_drawn
from viewer.scenes.matched import Difference, Match
from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.pose import Pose

#: Maximum distance of a picked point, pixels.
_NEAR = 3.0

#: All Gaussians are drawn.
_PLAIN = Look()


@dataclass(frozen=True)
class Hit:
    """The Gaussian hit by a click into a pane.

    Attributes
    ----------
    which : {0, 1}
        Index of the scene.
    row : int
        Row of the Gaussian in the scene, from 0.
    weight : float or None
        Its weight alpha T in the pixel, 0-1; None if a point was clicked.
    """

    which: int
    row: int
    weight: float | None = None


@dataclass(frozen=True)
class Contribution:
    """Contribution of a Gaussian to a view.

    Attributes
    ----------
    weight : float
        Sum of its weights alpha T over the pixels.
    pixels : int
        Number of pixels it contributes to.
    size : tuple of two int
        Width and height of the view, pixels.
    """

    weight: float
    pixels: int
    size: tuple[int, int]

    @property
    def share(self) -> float:
        """Share of the view's light from the Gaussian, 0-1: weight over number of pixels."""
        return self.weight / (self.size[0] * self.size[1])


@dataclass(frozen=True, eq=False)
class Picked:
    """A Gaussian with all information about it.

    Attributes
    ----------
    scene : Opened
    hit : Hit
    contribution : Contribution
        Contribution to the camera's own frame.
    coded : CodedGaussian or None
        None if `Opened.bits_unknown`.
    difference : Difference or None
        None if there is no second scene.
    pruned_by : str
        Reason for pruning; empty if it was kept or there is no report.
    """

    scene: Opened
    hit: Hit
    contribution: Contribution
    coded: CodedGaussian | None
    difference: Difference | None
    pruned_by: str = ""

    @property
    def position(self) -> NDArray[np.float32]:
        """Centre ``(3,)``, scene units."""
        return self.scene.gaussians.positions[:, self.hit.row]

    @property
    def scales(self) -> NDArray[np.float64]:
        """Standard deviations ``(3,)`` along its axes, scene units."""
        with np.errstate(over="ignore"):
            return np.exp(self.scene.gaussians.log_scale[:, self.hit.row].astype(np.float64))

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Unit quaternion wxyz ``(4,)``, w >= 0; the identity if the norm is 0."""
        rot = self.scene.gaussians.rot[:, self.hit.row].astype(np.float64)
        norm = np.linalg.norm(rot)
        unit = rot / norm if norm else np.eye(4)[0]
        return -unit if unit[0] < 0 else unit

    @property
    def turn(self) -> tuple[float, NDArray[np.float64]]:
        """The rotation as an angle in degrees and a unit axis ``(3,)``."""
        real, vector = self.rotation[0], self.rotation[1:]
        norm = np.linalg.norm(vector)
        axis = vector / norm if norm else np.eye(3)[0]
        return float(np.degrees(2 * np.arctan2(norm, real))), axis

    @property
    def opacity(self) -> float:
        """Opacity, 0-1."""
        return float(self.scene.opacities[self.hit.row])

    @property
    def colour(self) -> NDArray[np.float64]:
        """SH-DC colour, RGB ``(3,)``, clipped to 0-255."""
        return 255 * self.scene.colours[self.hit.row].astype(np.float64)

    @property
    def sh_energy(self) -> list[float]:
        """Sum of squares of the SH-AC of each band."""
        own = self.scene.gaussians.f_rest[:, self.hit.row].reshape(3, -1).astype(np.float64)
        return [float(np.sum(own[:, band] ** 2)) for band in sh_bands(own.shape[1])]


class Picker:
    """Picks Gaussians of one or two scenes.

    Parameters
    ----------
    scenes : sequence of Opened
    pruned : Pruned or None
        Pruned Gaussians of the first scene.
    """

    def __init__(self, scenes: Sequence[Opened], pruned: Pruned | None = None) -> None:
        self.scenes, self.pruned = tuple(scenes), pruned

    @cached_property
    def _match(self) -> Match:
        return Match(*self.scenes)

    def pick(
        self,
        which: int,
        pose: Pose,
        size: tuple[int, int],
        pixel: tuple[float, float],
        layers: Collection[str] = ("splats",),
        look: Look = _PLAIN,
    ) -> Hit | None:
        """The Gaussian of a scene shown at a pixel; None if there is none.

        Points on top take precedence: pruned points if that layer is in `layers`, and centres if
        splats are not. Otherwise it is the Gaussian with the largest weight.

        Parameters
        ----------
        which : {0, 1}
            Index of the scene.
        pose : Pose
        size : tuple of two int
            Width and height of its picture, pixels.
        pixel : tuple of two float
            Column and row in the picture, from its upper left corner.
        layers : collection of str
            Names in `LAYERS`.
        look : Look
            Gaussians that it does not draw are not picked.
        """
        scene = self.scenes[which]
        if "pruned" in layers and self.pruned is not None and which == 0:
            gone = np.flatnonzero(self.pruned.of(scene).labels)
            found = _point_at(scene.positions[gone], pose, size, pixel)
            if found is not None:
                return Hit(which, int(gone[found]))
        if "centres" in layers and not {"splats", "error"} & set(layers):
            mask = which_drawn(scene, look)
            shown = np.arange(scene.count) if mask is None else np.flatnonzero(mask)
            found = _point_at(scene.positions[shown], pose, size, pixel)
            return None if found is None else Hit(which, int(shown[found]))
        column, row = (min(max(int(at), 0), most - 1) for at, most in zip(pixel, size, strict=True))
        drawn = gaussians_drawn(scene, look)
        rows, weights = pixel_weights(drawn, as_camera(pose.camera(*size)), column, row)
        if not len(rows):
            return None
        most = int(np.argmax(weights))
        return Hit(which, int(rows[most]), float(weights[most]))

    def describe(self, hit: Hit, pose: Pose) -> Picked:
        """Collect all information about a Gaussian, as seen from a pose.

        Raises
        ------
        gs_codec.GsCodecError
            If the file has changed.
        """
        scene, row = self.scenes[hit.which], hit.row
        camera = as_camera(pose.camera(*pose.measured))
        contribution = Contribution(*gaussian_weight(scene.gaussians, camera, row), pose.measured)
        difference = self._match.difference(hit.which, row) if len(self.scenes) > 1 else None
        if difference is not None:  # and by its row in the file
            other = self.scenes[1 - hit.which]
            difference = replace(difference, row=int(other.rows[difference.row]))
        reason, stored = "", int(scene.rows[row])
        if self.pruned is not None and hit.which == 0 and self.pruned.labels[stored]:
            reason = self.pruned.reasons[self.pruned.labels[stored] - 1]
        coded = None if scene.bits_unknown else _coded(scene, stored)
        return Picked(scene, hit, contribution, coded, difference, reason)


def _coded(scene: Opened, row: int) -> CodedGaussian:
    scene.check_unchanged()
    return describe_gaussian_of_file(scene.path, row)


def _point_at(
    positions: NDArray, pose: Pose, size: tuple[int, int], pixel: tuple[float, float]
) -> int | None:
    """Index of the point ``(n, 3)`` near a pixel that is nearest to the camera."""
    places, depth = pose.project(positions, *size)
    distances = np.abs(places - np.array(pixel)).max(axis=1)
    near = np.flatnonzero((distances <= _NEAR) & (depth > 0))
    return int(near[np.argmin(depth[near])]) if len(near) else None
