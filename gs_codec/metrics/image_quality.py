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


@dataclass(frozen=True)
class Quality:
    """Similarity of two images, a mean over pairs, or a difference of two qualities.

    Attributes
    ----------
    psnr : float
        dB; infinite for equal images.
    ssim : float
        At most 1 (Wang et al. 2004): Gaussian window of sigma 1.5, 11 pixels wide, averaged over
        the pixels whose window is inside the image.
    lpips : float or None
        0 for equal images (Zhang et al. 2018, version 0.1); None if not measured. Images are scaled
        to -1 to 1, according to the definition; the script of the 3DGS paper leaves them in 0-1.
    """

    psnr: float
    ssim: float
    lpips: float | None = None

    def as_dict(self) -> dict[str, float | None]:
        """Convert for JSON; the infinite PSNR of equal images becomes None."""
        finite = np.isfinite(self.psnr)
        return {"psnr": self.psnr if finite else None, "ssim": self.ssim, "lpips": self.lpips}

    def over(self, other: Quality) -> Quality:
        """Difference, self minus `other`; 0 for equal values, including infinite ones."""

        def less(a: float, b: float) -> float:
            return 0.0 if a == b else a - b

        both = self.lpips is not None and other.lpips is not None
        return Quality(
            less(self.psnr, other.psnr),
            less(self.ssim, other.ssim),
            less(self.lpips, other.lpips) if both else None,  # type: ignore[arg-type]
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
    """Means of PSNR, SSIM, and of LPIPS if every pair has it."""
    lpips = [q.lpips for q in qualities if q.lpips is not None]
    return Quality(
        float(np.mean([q.psnr for q in qualities])),
        float(np.mean([q.ssim for q in qualities])),
        float(np.mean(lpips)) if len(lpips) == len(qualities) else None,
    )


@checked
def compare_images(first: NDArray, second: NDArray, lpips: str | Path | None = None) -> Quality:
    """Compare two images, clipped to 0-1.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, 3)
        RGB.
    lpips : path, optional
        As in `compare`; by default LPIPS is not measured.

    Returns
    -------
    Quality
        PSNR, SSIM and, with `lpips`, LPIPS.

    Raises
    ------
    InvalidInput
        If the sizes differ, or are too small for SSIM or LPIPS; or if the file has no such weights.
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
    if first.shape != second.shape:
        raise InvalidInput(f"images of {_size(first)} and {_size(second)} pixels")
    least, metric = (_SSIM_WINDOW, "SSIM") if lpips is None else (LPIPS_SIZE, "LPIPS")
    if min(first.shape[:2]) < least:
        raise InvalidInput(
            f"images of {_size(first)} pixels, expected at least {least} each way for {metric}"
        )
    a, b = (np.clip(image, 0, 1).astype(np.float64) for image in (first, second))
    distance = None if lpips is None else load_lpips(lpips).distance(a, b)
    return Quality(psnr(a, b), mean_ssim(a, b), distance)


def psnr(a: NDArray, b: NDArray) -> float:
    """Peak signal-to-noise ratio of images in 0-1, dB; infinite for equal ones."""
    error = float(np.mean((a - b) ** 2))
    return -10 * float(np.log10(error)) if error else float("inf")


def _size(image: NDArray) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
