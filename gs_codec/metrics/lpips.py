"""LPIPS with the package `lpips`; the weights of its backbone come from a file."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, MissingTool, one_line
from gs_codec.runtime.lazy import pip_install
from gs_codec.runtime.mapped import opened

#: Environment variable with the path of the weights, for `compare`.
VARIABLE = "GS_CODEC_LPIPS"

#: Minimum width and height of images, in pixels: AlexNet's; the others accept smaller ones.
LEAST = 31

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

    Raises
    ------
    InvalidInput
        If the file is missing, or not such a state dict.
    MissingTool
        If the package or one of its dependencies is not installed.
    """
    with opened(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about lpips' calls of torchvision
        try:
            import lpips
            import torch
        except (ImportError, RuntimeError) as error:  # or mismatched builds
            why = f"lpips cannot be imported ({one_line(error)})"
            raise MissingTool(f"{why}: {pip_install('lpips')}") from error
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
