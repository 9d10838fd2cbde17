"""Derivatives of the loss of a view with respect to all attributes of all Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.backward import differentiate_gaussians
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.image_loss import differentiate_loss
from gs_codec.rendering.project import camera_arguments
from gs_codec.rendering.tiles_float32 import MOMENT_YY, take_back_rows
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import GROUPS, Scene, channel_count


class Differentiated(NamedTuple):
    """A view of a scene, its mean squared error, and the derivatives of its loss by splat.

    ``sums (N, 9)`` are the sums of `take_back_rows`. ``chosen (M,)`` lists, ascending, the visible
    Gaussians: those whose sums are not all 0.
    """

    scene: Scene
    camera: Camera
    squared_error: float
    sums: NDArray[np.float64]
    chosen: NDArray[np.int64]

    def slopes(self, start: int, stop: int) -> NDArray[np.float32]:
        """Derivatives ``(stop - start, 14 + 3 K)`` by attributes of ``chosen[start:stop]``.

        Columns are the channels of the groups, in the order of `GROUPS`.
        """
        channels = channel_count(len(self.scene.f_rest) // 3)
        slopes = np.empty((stop - start, channels), np.float32)
        differentiate_gaussians(
            *(getattr(self.scene, group) for group in GROUPS),
            *camera_arguments(self.camera),
            self.scene.antialiased,
            self.sums,
            self.chosen,
            start,
            stop,
            slopes,
        )
        return slopes


def differentiate(
    scene: Scene, camera: Camera, target: NDArray[np.float32], background: Sequence[float]
) -> Differentiated:
    """Render a view and propagate its loss back to the splats (Kerbl et al. 2023, Appendix A).

    Derivatives have float32 precision. Otherwise they are exact, except that, as in 3DGS, the set
    and order of splats in each pixel is treated as constant. The derivative is 0 for an alpha at
    its limit and for a colour below 0. Beyond 1.3 times the field of view, the projection's
    Jacobian is that at the edge.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    target : ndarray, shape (H, W, 3), float32
    background : sequence of three float
        RGB behind everything.
    """
    frame = make_frame(scene, camera)
    colour, state = frame.draw_rows(background)
    by_colour, squared_error = differentiate_loss(colour, target)
    pairs = np.empty((frame.pairs, MOMENT_YY + 1))
    behind = np.array(background, np.float64)
    frame.over_tiles(take_back_rows, behind, by_colour, *state, pairs)
    sums = frame.sum_pairs(scene.count, pairs)
    chosen = np.empty(len(frame.splats.gaussians), np.int64)
    count = _choose(sums, chosen)
    return Differentiated(scene, camera, squared_error, sums, chosen[:count])


@kernel
def _choose(sums, chosen):
    """List the rows that are not all 0; return their number."""
    count = 0
    for i in range(len(sums)):
        for value in sums[i]:
            if value != 0.0:
                chosen[count] = i
                count += 1
                break
    return count
