"""gsplat's rasteriser (release 1.5) for one camera, in plain torch: every splat in every pixel.

It implements only the rule, in float64, for scenes of few Gaussians and small views.
"""

from __future__ import annotations

import torch

from gs_codec.scene import SH_C0, sh_values

MIN_ALPHA, MAX_ALPHA, STOP = 1 / 255, 0.99, 1e-4


def rasterization(
    *, means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane, eps2d,  # noqa: N803
    sh_degree, packed, backgrounds, render_mode, rasterize_mode,
):  # fmt: skip
    """Images (1, H, W, 3 or 4), alphas (1, H, W, 1), and the metadata that is used."""
    count = len(means)
    shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}
    shapes["colors"] = ((sh_degree + 1) ** 2, 3)
    given = {"means": means, "quats": quats, "scales": scales, "opacities": opacities}
    given["colors"] = colors
    for name, shape in shapes.items():
        assert given[name].shape == (count, *shape), name
        assert given[name].dtype == torch.float32, name
    assert (viewmats.shape, Ks.shape, backgrounds.shape) == ((1, 4, 4), (1, 3, 3), (1, 3))
    assert (near_plane, eps2d, packed) == (0.2, 0.3, False)
    means, quats, scales, opacities, colors = (each.double() for each in given.values())
    pose, lens, behind = viewmats[0].double(), Ks[0].double(), backgrounds[0].double()

    at = means @ pose[:3, :3].T + pose[:3, 3]
    nearest = torch.argsort(at[:, 2].detach(), stable=True)
    nearest = nearest[at[nearest, 2] > near_plane]
    at, z = at[nearest], at[nearest, 2]
    xx, xy, yy = _covariance(at, quats[nearest], scales[nearest], pose, lens, width, height)
    sharp, xx, yy = xx * yy - xy * xy, xx + eps2d, yy + eps2d
    determinant = xx * yy - xy * xy
    opacity = opacities[nearest]
    if rasterize_mode == "antialiased":
        opacity = opacity * (sharp / determinant).clamp(min=0).sqrt()
    else:
        assert rasterize_mode == "classic"

    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    centre = at[:, :2] / z[:, None] * lens.diagonal()[:2] + lens[:2, 2]
    dx = columns + 0.5 - centre[:, 0, None, None]
    dy = rows + 0.5 - centre[:, 1, None, None]
    a, b, c, opacity = ((v)[:, None, None] for v in (yy, -xy, xx, opacity))
    q = (a * dx * dx + 2 * b * dx * dy + c * dy * dy) / determinant[:, None, None]
    alpha = (opacity * (-q / 2).exp()).clamp(max=MAX_ALPHA)
    alpha = torch.where(alpha >= MIN_ALPHA, alpha, 0)
    # A pixel is done before the first splat that would leave too little light.
    alpha = torch.where(torch.cumprod(1 - alpha, 0) > STOP, alpha, 0)
    passed = torch.cumprod(1 - alpha, 0)
    weights = alpha * torch.cat([torch.ones_like(passed[:1]), passed])[:-1]
    covered = weights.sum(0)[..., None]

    directions = means[nearest] + pose[:3, :3].T @ pose[:3, 3]
    values = _colours(colors[nearest], directions / directions.norm(dim=1, keepdim=True))
    image = torch.einsum("nhw,nc->hwc", weights, values) + (1 - covered) * behind
    if render_mode == "RGB+ED":
        depth = torch.einsum("nhw,n->hw", weights, z)[..., None] / covered.clamp(min=1e-10)
        image = torch.cat([image, depth], dim=2)
    else:
        assert render_mode == "RGB"
    pairs = {"flatten_ids": torch.zeros(int((alpha > 0).any(2).any(1).sum()))}
    return image[None].float(), covered[None].float(), pairs


def _covariance(at, quats, scales, pose, lens, width, height):
    """Covariance in the image, in pixels, before the low-pass."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).T
    turn = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    axes = pose[:3, :3] @ torch.stack(turn, dim=1).view(-1, 3, 3) * scales[:, None]
    sizes, focal = torch.tensor([width, height]), lens.diagonal()[:2]
    margin = 0.15 * sizes / focal
    low, high = -lens[:2, 2] / focal - margin, (sizes - lens[:2, 2]) / focal + margin
    slopes = torch.minimum(torch.maximum(at[:, :2] / at[:, 2:], low), high)
    u, v = (
        (focal / at[:, 2:])[:, None] * (axes[:, :2] - slopes[..., None] * axes[:, 2:]).mT
    ).unbind(2)
    return (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)


def _colours(sh, directions):
    """Colours of SH (N, 1 + K, 3), at least 0."""
    coefficients = sh.shape[1] - 1
    basis = torch.zeros(15, len(sh), dtype=torch.float64)
    planes = list(basis)
    sh_values(*directions.T, coefficients, planes)
    value = 0.5 + SH_C0 * sh[:, 0]
    for k in range(coefficients):
        value = value + planes[k][:, None] * sh[:, 1 + k]
    return value.clamp(min=0)
