"""SSIM of two images, and the derivative of the 3DGS loss (Kerbl et al. 2023, Equation 7)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import available_threads, run_all

if TYPE_CHECKING:
    import torch

#: Weight of the mean absolute error in the loss, as in 3DGS.
_ABSOLUTE = 0.8

#: Weight of 1 - SSIM in the loss.
_SSIM = 0.2

#: Half the width of the SSIM window, in pixels.
_HALF = 5

#: Number of rows that a window needs.
_ROWS = 2 * _HALF + 1

_GAUSSIAN = np.exp(-(np.arange(-_HALF, _HALF + 1.0) ** 2) / (2 * 1.5**2))
_WINDOW = tuple((_GAUSSIAN / _GAUSSIAN.sum())[: _HALF + 1].tolist())

#: Constants of SSIM for values from 0 to 1.
_C1 = 0.01**2
_C2 = 0.03**2

#: Number of image rows per task.
_BAND = 16


def differentiate_loss(colour: NDArray, target: NDArray) -> tuple[NDArray[np.float64], float]:
    """Derivative of the loss by an unclipped image ``(H, W, 3)``, and the mean squared error.

    SSIM uses a Gaussian window of sigma 1.5, 11 pixels wide (Wang et al. 2004). As in the 3DGS
    trainer, values outside the image are 0.
    """
    height = len(colour)
    image, target = colour.reshape(height, -1), target.reshape(height, -1)
    by_image, errors = np.empty_like(image), np.empty(height)
    # Wide bands, because each also blurs the rows around it.
    size = -(-height // available_threads())
    run_all(
        lambda y: _differentiate(image, target, y, min(y + size, height), by_image, errors),
        range(0, height, size),
    )
    return by_image.reshape(colour.shape), float(errors.sum() / image.size)


def differentiate_squares(colour: NDArray, target: NDArray) -> tuple[NDArray, float]:
    """Derivative of the sum of squared errors by an image ``(H, W, 3)``, and their mean."""
    error = colour - target
    return 2 * error, float(np.mean(np.square(error, dtype=np.float64)))


def mean_ssim(
    first: NDArray[np.float64], second: NDArray[np.float64], mask: NDArray[np.bool_] | None = None
) -> float:
    """SSIM of two images ``(H, W, 3)`` in 0-1, at least 11 pixels wide and high.

    The window is that of `differentiate_loss`; the mean is over pixels whose window lies within
    the image, and which are in the mask ``(H, W)`` if there is one.
    """
    height, width, _ = first.shape
    a, b = first.reshape(height, -1), second.reshape(height, -1)
    means = np.empty((5, height + 2 * _HALF, 3 * width))
    inner = height - 2 * _HALF
    ssim = np.empty((inner, 3 * (width - 2 * _HALF)))
    run_all(lambda band: _blur_across(a, b, *band, means), _bands(height))
    run_all(lambda band: _fill_ssim(means, *band, ssim), _bands(inner))
    if mask is None:
        return float(ssim.mean())
    return float(ssim.reshape(inner, -1, 3)[mask[_HALF:-_HALF, _HALF:-_HALF]].mean())


def _bands(height: int) -> list[tuple[int, int]]:
    """First and end row of each task."""
    return [(y, min(y + _BAND, height)) for y in range(0, height, _BAND)]


def differentiate_loss_tensor(
    colour: torch.Tensor, target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """`differentiate_loss` for tensors, in their precision."""
    import torch
    from torch.nn.functional import conv2d

    taps = [*_WINDOW, *reversed(_WINDOW[:-1])]
    window = torch.tensor(taps, dtype=colour.dtype, device=colour.device).expand(15, 1, 1, -1)
    # cuDNN may round to ten bits, which is too coarse for the differences below.
    with torch.enable_grad(), torch.backends.cudnn.flags(enabled=False):
        image = colour.detach().permute(2, 0, 1).requires_grad_()
        wanted = target.permute(2, 0, 1)
        planes = torch.cat([image, wanted, image * image, wanted * wanted, image * wanted])[None]
        across = conv2d(planes, window, padding=(0, _HALF), groups=15)
        blurred = conv2d(across, window.mT, padding=(_HALF, 0), groups=15)
        x, t, xx, tt, xt = blurred[0].split(3)
        top = (2 * x * t + _C1) * (2 * (xt - x * t) + _C2)
        ssim = top / ((x * x + t * t + _C1) * (xx - x * x + tt - t * t + _C2))
        error = image - wanted
        loss = _ABSOLUTE * error.abs().mean() - _SSIM * ssim.mean()
        (by_image,) = torch.autograd.grad(loss, image)
    return by_image.permute(1, 2, 0), (error.detach() ** 2).mean()


@inlined
def _blur_row(padded, out):
    """Blur a row of RGB with the window; `padded` has 5 more pixels at either end."""
    w0, w1, w2, w3, w4, w5 = _WINDOW
    for j in range(len(out)):
        out[j] = (
            w5 * padded[j + 15]
            + w4 * (padded[j + 12] + padded[j + 18])
            + w3 * (padded[j + 9] + padded[j + 21])
            + w2 * (padded[j + 6] + padded[j + 24])
            + w1 * (padded[j + 3] + padded[j + 27])
            + w0 * (padded[j] + padded[j + 30])
        )


@inlined
def _blur_column(plane, y, out):
    """Blur rows `y` to `y` + 10 of a plane with the window; after its last row comes its first."""
    w0, w1, w2, w3, w4, w5 = _WINDOW
    rows = len(plane)
    # Two loops, because the compiler does not vectorise one over this many arrays.
    a, b, c, d, e = (y + 3) % rows, (y + 4) % rows, (y + 5) % rows, (y + 6) % rows, (y + 7) % rows
    for j in range(len(out)):
        out[j] = (
            w5 * plane[c, j] + w4 * (plane[b, j] + plane[d, j]) + w3 * (plane[a, j] + plane[e, j])
        )
    a, b, c = y % rows, (y + 1) % rows, (y + 2) % rows
    d, e, f = (y + 8) % rows, (y + 9) % rows, (y + 10) % rows
    for j in range(len(out)):
        out[j] += (
            w2 * (plane[c, j] + plane[d, j])
            + w1 * (plane[b, j] + plane[e, j])
            + w0 * (plane[a, j] + plane[f, j])
        )


@inlined
def _blur_image_row(image, target, y, padded, means):
    """Fill row `y` + 5 of `means`: windowed sums of x, t, x^2, t^2 and x t along an image row."""
    place = (y + _HALF) % means.shape[1]
    for j in range(image.shape[1]):
        x, t = image[y, j], np.float64(target[y, j])
        padded[0, 15 + j] = x
        padded[1, 15 + j] = t
        padded[2, 15 + j] = x * x
        padded[3, 15 + j] = t * t
        padded[4, 15 + j] = x * t
    for k in range(5):
        _blur_row(padded[k], means[k, place])


@kernel
def _blur_across(image, target, first, end, means):
    """`_blur_image_row` for rows `first` to `end`."""
    padded = np.zeros((5, image.shape[1] + 30))
    for y in range(first, end):
        _blur_image_row(image, target, y, padded, means)


@kernel
def _fill_ssim(means, first, end, ssim):
    """Fill rows of SSIM, without the 5 pixels at either end, of rows from the fifth on."""
    size = means.shape[2]
    window = np.empty((5, size))
    for y in range(first, end):
        for k in range(5):
            _blur_column(means[k], y + _HALF, window[k])
        for j in range(3 * _HALF, size - 3 * _HALF):
            x, t = window[0, j], window[1, j]
            top = (2.0 * x * t + _C1) * (2.0 * (window[4, j] - x * t) + _C2)
            spread = window[2, j] - x * x + window[3, j] - t * t + _C2
            ssim[y, j - 3 * _HALF] = top / ((x * x + t * t + _C1) * spread)


@inlined
def _compare_windows(means, y, factor, padded, window, slopes):
    """Fill row `y` + 5 of `slopes`: windowed sums along an image row.

    They are of the derivatives of SSIM by the windowed x, x^2 and x t.
    """
    for k in range(5):
        _blur_column(means[k], y, window[k])
    for j in range(means.shape[2]):
        x, t = window[0, j], window[1, j]
        top_mean = 2.0 * x * t + _C1
        top_spread = 2.0 * (window[4, j] - x * t) + _C2
        mean = 1.0 / (x * x + t * t + _C1)
        spread = 1.0 / (window[2, j] - x * x + window[3, j] - t * t + _C2)
        ssim = top_mean * top_spread * mean * spread
        by_both = 2.0 * factor * top_mean * mean * spread
        by_square = -factor * ssim * spread
        padded[0, 15 + j] = (
            2.0 * factor * mean * (t * top_spread * spread - x * ssim)
            - 2.0 * x * by_square
            - t * by_both
        )
        padded[1, 15 + j] = by_square
        padded[2, 15 + j] = by_both
    place = (y + _HALF) % slopes.shape[1]
    for k in range(3):
        _blur_row(padded[k], slopes[k, place])


@kernel
def _differentiate(image, target, first, end, by_image, errors):
    """Fill rows `first` to `end` of the derivative, and the squared error of each.

    `means` and `slopes` hold the last 11 rows, so that they stay in the cache; rows outside the
    image are 0.
    """
    height, size = image.shape
    means, slopes = np.zeros((5, _ROWS, size)), np.zeros((3, _ROWS, size))
    of_image, of_slopes = np.zeros((5, size + 30)), np.zeros((3, size + 30))
    window = np.empty((5, size))
    ssim, absolute = -_SSIM / image.size, _ABSOLUTE / image.size
    for y in range(first - 2 * _HALF, end + 2 * _HALF):
        if 0 <= y < height:
            _blur_image_row(image, target, y, of_image, means)
        else:
            means[:, (y + _HALF) % _ROWS] = 0.0
        middle = y - _HALF
        if first - _HALF <= middle and 0 <= middle < height:
            _compare_windows(means, middle, ssim, of_slopes, window, slopes)
        else:
            slopes[:, (middle + _HALF) % _ROWS] = 0.0
        row = middle - _HALF
        if row < first:
            continue
        for k in range(3):
            _blur_column(slopes[k], row, window[k])
        squared = 0.0
        for j in range(size):
            x, t = image[row, j], np.float64(target[row, j])
            error = x - t
            squared += error * error
            by_image[row, j] = (
                absolute * np.sign(error) + window[0, j] + 2.0 * x * window[1, j] + t * window[2, j]
            )
        errors[row] = squared
