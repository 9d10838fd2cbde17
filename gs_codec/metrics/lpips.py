"""LPIPS by the package `lpips`; the weights of its backbone come from a file."""

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

#: The environment variable that names the file for `compare`.
VARIABLE = "GS_CODEC_LPIPS"

#: Least width and height of images, pixels: AlexNet's; the others take smaller ones.
LEAST = 31

#: Backbones by the package's names: what they are called, and a weight that tells each.
_BACKBONES = {
    "vgg": ("VGG16", "features.26.weight"),
    "squeeze": ("SqueezeNet 1.1", "features.12.squeeze.weight"),
    "alex": ("AlexNet", "features.10.weight"),
}


@dataclass(frozen=True)
class Lpips:
    """The metric by one backbone; values of different ones are not comparable."""

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
    """The metric by the backbone whose state dict of torchvision is in a file.

    Raises
    ------
    InvalidInput
        If the file is missing, or something else.
    MissingTool
        If the package, or what it needs, is not installed.
    """
    with opened(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what lpips asks of torchvision
        try:
            import lpips
            import torch
        except (ImportError, RuntimeError) as error:  # the latter if torchvision is not torch's
            why = f"lpips cannot be imported ({one_line(error)})"
            raise MissingTool(f"{why}: {pip_install('lpips')}") from error
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            net = next(net for net, (_, own) in _BACKBONES.items() if own in state)
            network = lpips.LPIPS(net=net, pnet_rand=True, verbose=False)
            # features.0.weight is slice1.0.weight here
            names = {n: f"features.{n.partition('.')[2]}" for n in network.net.state_dict()}
            network.net.load_state_dict({n: state[name] for n, name in names.items()})
        except Exception as error:  # of many types, as files may hold anything
            known = ", ".join(name for name, _ in _BACKBONES.values())
            text = f"{path}: not a state dict of torchvision, expected one of {known}"
            raise InvalidInput(text) from error
    return Lpips(_BACKBONES[net][0], network)
