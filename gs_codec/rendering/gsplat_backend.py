"""Views of a scene and their gradients with gsplat on a CUDA device, if both are available.

gsplat follows the same rules as our rasteriser, with these differences: since 1.5 it bounds a splat
at 3.33 sigma instead of 3; up to 1.5.3 it clamps alpha to 0.999 instead of 0.99; opacity
compensation has no lower bound; and it uses float32. Images agree with ours to 40 dB or better.
Like ours, it skips alpha below 1/255 and stops at a transmittance of 1e-4. Gradients are summed in
no fixed order, so two runs differ in the last digits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.image_loss import differentiate_loss_tensor
from gs_codec.rendering.project import LOW_PASS
from gs_codec.runtime.optional import is_available, missing_package
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene, group_rows

if TYPE_CHECKING:
    import torch

_DEVICE = "cuda"


@cache
def sees_device() -> bool:
    """Whether gsplat is installed and torch sees a CUDA device; torch is loaded only if needed."""
    if not is_available("gsplat", "torch"):
        return False
    import torch

    return torch.cuda.is_available()


def is_chosen(device: Literal["auto", "cpu", "cuda"]) -> bool:
    """Whether `device` selects gsplat.

    Raises MissingTool if `device` is ``cuda`` and gsplat is not available.
    """
    if device == "cuda" and not sees_device():
        raise missing_package("gsplat", "device 'cuda'")
    return device != "cpu" and sees_device()


def to_device(array: NDArray) -> torch.Tensor:
    """A tensor on the device, float32."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(array, np.float32)).to(_DEVICE)


def upload(scene: Scene) -> torch.Tensor:
    """All channels of a scene, ``(N, C)``, in the order of `GROUPS`."""
    return to_device(np.concatenate([getattr(scene, group) for group in GROUPS])).T.contiguous()


def draw(
    values: torch.Tensor, camera: Camera, background: Sequence[float], antialiased: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], int]:
    """Colour ``(H, W, 3)``, alpha and depth ``(H, W)``, and the number of splat-tile pairs.

    `values` is the result of `upload`.
    """
    import torch

    with torch.no_grad():
        images, alphas, meta = _rasterise(values, camera, background, antialiased, "RGB+ED")
    image, alpha = images[0].cpu().numpy(), alphas[0, ..., 0].cpu().numpy()
    pairs = int(meta["flatten_ids"].numel())
    return image[..., :3].copy(), alpha, image[..., 3].copy(), pairs


def differentiate(
    values: torch.Tensor,
    camera: Camera,
    target: torch.Tensor,
    background: Sequence[float],
    antialiased: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Derivatives of the loss of a view by ``values (N, C)``, and its mean squared error.

    The same as `gradients.differentiate`, on the device; Gaussians that are not visible have zeros.
    """
    import torch

    values = values.detach().requires_grad_()
    images, _, _ = _rasterise(values, camera, background, antialiased, "RGB")
    by_image, squared_error = differentiate_loss_tensor(images[0].detach(), target)
    (slopes,) = torch.autograd.grad(images, values, by_image[None])
    return slopes, squared_error


def _rasterise(
    values: torch.Tensor, camera: Camera, background: Sequence[float], antialiased: bool, mode: str
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """The raw output of gsplat; derivatives propagate back to `values`."""
    import gsplat
    import torch

    sh_degree = math.isqrt((values.shape[1] - 11) // 3) - 1
    coefficients = SH_COEFFICIENTS[sh_degree]
    rows = list(group_rows(coefficients).values())
    means, f_dc, f_rest, opacity, log_scale, rot = values.split(rows, dim=1)
    rest = f_rest.reshape(len(values), 3, coefficients).transpose(1, 2)
    identity = to_device(np.array([1, 0, 0, 0]))
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation
    pose[:3, 3] = -camera.rotation @ camera.position
    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    return gsplat.rasterization(
        means=means,
        quats=torch.where(rot.any(1, keepdim=True), rot, identity),
        scales=log_scale.exp(),
        opacities=opacity[:, 0].sigmoid(),
        colors=torch.cat([f_dc[:, None], rest], dim=1),
        viewmats=to_device(pose)[None],
        Ks=to_device(lens)[None],
        width=camera.width,
        height=camera.height,
        near_plane=camera.near,
        eps2d=LOW_PASS,
        sh_degree=sh_degree,
        packed=False,
        backgrounds=to_device(np.array([background])),
        render_mode=mode,
        rasterize_mode="antialiased" if antialiased else "classic",
    )
