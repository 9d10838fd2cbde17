"""Quality of images: PSNR, SSIM, and LPIPS (by the package `lpips`, with weights from a file)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.rendering.image_loss import mean_ssim
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.mapped import opened
from gs_codec.runtime.optional import needed

#: Environment variable with the path of the weights, for `compare`.
LPIPS_VARIABLE = "GS_CODEC_LPIPS"

#: Minimum width and height of images, in pixels: AlexNet's; the others accept smaller ones.
LPIPS_SIZE = 31

#: Backbones by the package's names: display name, and a weight that identifies each.
_BACKBONES = {
    "vgg": ("VGG16", "features.26.weight"),
    "squeeze": ("SqueezeNet 1.1", "features.12.squeeze.weight"),
    "alex": ("AlexNet", "features.10.weight"),
}


@dataclass(frozen=True)
class Lpips:
    """LPIPS with one backbone; values of different backbones are not comparable."""

    backbone: str
    network: Any

    def distance(self, a: NDArray, b: NDArray) -> float:
        """LPIPS of images ``(H, W, 3)`` in 0-1."""
        import torch

        first, second = (torch.from_numpy(x.transpose(2, 0, 1)[None]).float() for x in (a, b))
        with torch.no_grad():
            return float(self.network(first, second, normalize=True))


@cache
def load_lpips(path: str | Path) -> Lpips:
    """Load LPIPS with the backbone whose torchvision state dict is in a file.

    Raises InvalidInput if the file is missing, or not such a state dict. Raises MissingTool if the
    package or one of its dependencies is not installed.
    """
    with opened(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about lpips' calls of torchvision
        lpips, torch = needed("lpips", "LPIPS"), needed("torch", "LPIPS")
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            net = next(net for net, (_, own) in _BACKBONES.items() if own in state)
            network = lpips.LPIPS(net=net, pnet_rand=True, verbose=False)
            # features.0.weight is called slice1.0.weight here
            names = {n: f"features.{n.partition('.')[2]}" for n in network.net.state_dict()}
            network.net.load_state_dict({n: state[name] for n, name in names.items()})
        except Exception as error:  # files may contain anything, so many types are possible
            known = ", ".join(name for name, _ in _BACKBONES.values())
            text = f"{path}: not a state dict of torchvision, expected one of {known}"
            raise InvalidInput(text) from error
    return Lpips(_BACKBONES[net][0], network)


#: Side of the window of SSIM, pixels.
_SSIM_WINDOW = 11

#: Y, U and V of RGB in 0-1 (BT.709, full range), and their weights in MPEG's conditions.
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_YUV = np.array([_LUMA, ([0, 0, 1] - _LUMA) / 1.8556, ([1, 0, 0] - _LUMA) / 1.5748])
_YUV_WEIGHTS = (6, 1, 1)

#: Minimum mean squared error of a plane, which is 100 dB: that of grey images is 0 in U and V.
_LEAST = 1e-10


@dataclass(frozen=True)
class Quality:
    """Similarity of two images, a mean over pairs, or a difference of two qualities.

    Attributes
    ----------
    psnr : float
        dB; infinite for equal images, which a mean leaves out unless all are equal.
    ssim : float
        At most 1 (Wang et al. 2004): Gaussian window of sigma 1.5, 11 pixels wide, averaged over
        the pixels whose window is inside the image.
    lpips : float or None
        0 for equal images (Zhang et al. 2018, version 0.1); None if not measured. Images are scaled
        to -1 to 1, according to the definition; the script of the 3DGS paper leaves them in 0-1.
    psnr_yuv : float
        dB, as in MPEG's conditions: the mean of the PSNR of Y, U and V (BT.709, full range; each at
        most 100 dB), weighted 6:1:1; infinite for equal images.

    Examples
    --------
    >>> import numpy as np
    >>> grey = np.full((16, 16, 3), 0.5, np.float32)
    >>> quality = gs_codec.compare_images(grey, grey + 0.1)
    >>> round(quality.psnr, 3), quality.ssim < 1, quality.lpips
    (20.0, True, None)
    """

    psnr: float
    ssim: float
    lpips: float | None = None
    psnr_yuv: float = float("inf")

    def as_dict(self) -> dict[str, float | None]:
        """Convert for JSON; the infinite PSNR of equal images becomes None."""
        psnr, yuv = (x if np.isfinite(x) else None for x in (self.psnr, self.psnr_yuv))
        return {"psnr": psnr, "ssim": self.ssim, "lpips": self.lpips, "psnr_yuv": yuv}

    def over(self, other: Quality) -> Quality:
        """Difference, self minus `other`; 0 for equal values, including infinite ones."""

        def less(a: float, b: float) -> float:
            return 0.0 if a == b else a - b

        both = self.lpips is not None and other.lpips is not None
        return Quality(
            less(self.psnr, other.psnr),
            less(self.ssim, other.ssim),
            less(self.lpips, other.lpips) if both else None,  # type: ignore[arg-type]
            less(self.psnr_yuv, other.psnr_yuv),
        )


@dataclass(frozen=True)
class View:
    """One view of two scenes.

    Attributes
    ----------
    name : str
        Name of the camera.
    between : Quality
        Quality of the second scene's image relative to the first's.
    first, second : Quality or None
        Quality of each relative to the ground truth, if given.

    Examples
    --------
    >>> [view, _] = gs_codec.compare("scene.ply", "scene.egs", "cameras.json", width=48).views
    >>> view.name, view.between.psnr > 35, view.first
    ('00000', True, None)
    """

    name: str
    between: Quality
    first: Quality | None = None
    second: Quality | None = None

    @property
    def delta(self) -> Quality | None:
        """Quality of the second scene minus the first's, against ground truth (paper's deltas)."""
        if self.first is None or self.second is None:
            return None
        return self.second.over(self.first)


def mean_quality(qualities: Sequence[Quality]) -> Quality:
    """Means of each metric, and of LPIPS if every pair has it.

    The mean PSNR is that of pairs that differ: an equal pair, such as two views of nothing, would
    make it infinite and hide the loss of all others.
    """
    lpips = [q.lpips for q in qualities if q.lpips is not None]
    return Quality(
        _mean_psnr([q.psnr for q in qualities]),
        float(np.mean([q.ssim for q in qualities])),
        float(np.mean(lpips)) if len(lpips) == len(qualities) else None,
        _mean_psnr([q.psnr_yuv for q in qualities]),
    )


def _mean_psnr(values: Sequence[float]) -> float:
    return float(np.mean([value for value in values if value != float("inf")] or values))


@checked
def compare_images(
    first: NDArray,
    second: NDArray,
    lpips: str | Path | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> Quality:
    """Compare two images of floats, clipped to 0-1.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, 3)
        RGB, from 0 to 1.
    lpips : path, optional
        As in `compare`; by default LPIPS is not measured.
    mask : ndarray, shape (H, W), bool, optional
        The pixels to compare, by default all; the others count as black in both images.

    Returns
    -------
    Quality
        PSNR, SSIM and, with `lpips`, LPIPS.

    Raises
    ------
    InvalidInput
        If an image is not of floats; if the sizes differ, or are too small for SSIM or LPIPS; if
        the mask has no pixel whose window of SSIM is inside the image; or if the file has no such
        weights.
    MissingTool
        If LPIPS is requested, and its package is not installed.

    Examples
    --------
    >>> (camera, drawn), *_ = gs_codec.render("scene.ply", "cameras.json")
    >>> gs_codec.compare_images(drawn.colour, drawn.colour * 0.5).psnr > 5
    True
    """
    first, second = np.asarray(first), np.asarray(second)
    for image in (first, second):
        if image.ndim != 3 or image.shape[2] != 3:
            raise InvalidInput(f"image of shape {image.shape}, expected (H, W, 3)")
        if image.dtype.kind != "f":
            raise InvalidInput(f"image of {image.dtype}, expected floats from 0 to 1")
    if first.shape != second.shape:
        raise InvalidInput(f"images of {_size(first)} and {_size(second)} pixels")
    least, metric = (_SSIM_WINDOW, "SSIM") if lpips is None else (LPIPS_SIZE, "LPIPS")
    if min(first.shape[:2]) < least:
        raise InvalidInput(
            f"images of {_size(first)} pixels, expected at least {least} each way for {metric}"
        )
    a, b = (np.clip(image, 0, 1).astype(np.float64) for image in (first, second))
    if mask is not None:
        mask = _checked_mask(mask, a.shape)
        a, b = (image * mask[..., None] for image in (a, b))
    distance = None if lpips is None else load_lpips(lpips).distance(a, b)
    ssim = mean_ssim(a, b, mask)
    if mask is not None:
        a, b = a[mask], b[mask]
    return Quality(psnr(a, b), ssim, distance, _psnr_yuv(a - b))


def _checked_mask(mask: NDArray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    mask = np.asarray(mask, bool)
    if mask.shape != shape[:2]:
        raise InvalidInput(f"mask of shape {mask.shape}, expected {shape[:2]}")
    half = _SSIM_WINDOW // 2
    if not mask[half:-half, half:-half].any():
        raise InvalidInput("mask has no pixel whose SSIM window is inside the image")
    return mask


def _psnr_yuv(difference: NDArray[np.float64]) -> float:
    """The weighted PSNR of Y, U and V of a difference of RGB images."""
    if not difference.any():
        return float("inf")
    errors = np.mean((difference.reshape(-1, 3) @ _YUV.T) ** 2, axis=0)
    return float(np.average(-10 * np.log10(np.maximum(errors, _LEAST)), weights=_YUV_WEIGHTS))


def psnr(a: NDArray, b: NDArray) -> float:
    """Peak signal-to-noise ratio of images in 0-1, dB; infinite for equal ones."""
    error = float(np.mean((a - b) ** 2))
    return -10 * float(np.log10(error)) if error else float("inf")


def _size(image: NDArray) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
