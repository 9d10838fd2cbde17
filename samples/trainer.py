"""A trainer's loop with the codec: a coarsely coded scene is retrained, and coded on the way.

    python samples/trainer.py scene.ply cameras.json trained.pt --iterations 200

The parameters are gsplat's (`means quats scales opacities sh0 shN`), optimised by Adam of torch.
Gradients come from our renderer, so it runs on any CPU. A trainer with a GPU would use
``loss.backward()`` with `gsplat.rasterization` instead; everything else stays the same.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import gs_codec
from gs_codec.errors import GsCodecError
from gs_codec.formats.cloud import from_cloud
from gs_codec.formats.tensors import tensors_of
from gs_codec.preparation.adam import rig_radius
from gs_codec.preparation.optimise import with_values
from gs_codec.rendering.gradients import differentiate
from gs_codec.scene import channel_count

#: Learning rates of gsplat's trainer; that of `means` is in radii of the camera rig.
_RATES = {
    "means": 1.6e-4,
    "quats": 1e-3,
    "scales": 5e-3,
    "opacities": 5e-2,
    "sh0": 2.5e-3,
    "shN": 2.5e-3 / 20,
}


def backward(splats: Mapping[str, torch.nn.Parameter], camera: Any, image: np.ndarray) -> None:
    """Set the gradients of all parameters to those of a view's loss."""
    scene = from_cloud(gs_codec.from_tensors(splats))
    seen = differentiate(scene, camera, image, (0.0, 0.0, 0.0))
    planes = np.zeros((channel_count(len(scene.f_rest) // 3), scene.count), np.float32)
    planes[:, seen.chosen] = seen.slopes(0, len(seen.chosen)).T
    for name, gradient in tensors_of(with_values(scene, planes)).items():
        splats[name].grad = torch.from_numpy(gradient)


def train(
    source: Path, cameras: Path, iterations: int, every: int, width: int | None = None
) -> torch.nn.ParameterDict:
    """Encode a scene with profile `s`, then train the result towards renders of the scene.

    Prints iterations, mean PSNR of the views, and the compression ratio of profile `m`.
    """
    cloud = gs_codec.read(source)
    views = [(camera, view.colour) for camera, view in gs_codec.render(cloud, cameras, width=width)]
    lossy = gs_codec.decode(gs_codec.encode(cloud, gs_codec.Config("s", coarseness=2)))
    splats = torch.nn.ParameterDict(gs_codec.to_tensors(lossy, "torch"))
    rates = _RATES | {"means": _RATES["means"] * rig_radius([camera for camera, _ in views])}
    adam = torch.optim.Adam(
        [{"params": [splats[name]], "lr": rate} for name, rate in rates.items()], eps=1e-15
    )
    for done in range(iterations + 1):
        if done % every == 0 or done == iterations:
            now = gs_codec.from_tensors(splats)
            data = gs_codec.encode(now)
            quality = gs_codec.compare(cloud, now, cameras, width=width).mean.between.psnr
            times = gs_codec.inspect(data).ratio
            print(f"{done:6} iterations: {quality:.2f} dB, {times:.1f}x")
        if done < iterations:
            backward(splats, *views[torch.randint(len(views), ())])
            adam.step()
    return splats


def main(arguments: Sequence[str] | None = None) -> int:
    """Run as a program; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("source", type=Path, help="initial scene")
    parser.add_argument("cameras", type=Path, help="file of the cameras, such as cameras.json")
    parser.add_argument("target", type=Path, help="trained scene to write (.pt, .ply, .egs, ...)")
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument(
        "--every",
        type=int,
        default=50,
        choices=range(1, 10**6),
        metavar="N",
        help="iterations between reports",
    )
    parser.add_argument("--width", type=int, help="width of the views, pixels")
    asked = parser.parse_args(arguments)
    torch.manual_seed(0)
    try:
        splats = train(asked.source, asked.cameras, asked.iterations, asked.every, asked.width)
        gs_codec.write(asked.target, gs_codec.from_tensors(splats))
    except GsCodecError as error:
        print(f"trainer: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
