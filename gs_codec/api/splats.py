"""Decode an `.egs` stream to tensors on a device, ready for rendering; encode tensors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from numba import config

from gs_codec.api.trainer_tensors import array_of
from gs_codec.codecs.decode import ChosenPart, carried, choose_part
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import opened_slabs
from gs_codec.coding.clean import with_finite_ends
from gs_codec.config import ADAPTIVE_PROFILES, EGS, LOSSLESS, Config, as_config
from gs_codec.egs.header import Feature
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.formats.tensors import scene_of_tensors
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.mapped import located
from gs_codec.runtime.optional import is_available, missing_package, needed
from gs_codec.scene import SH_COEFFICIENTS

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Splats:
    """Gaussians for gsplat's rasteriser: float32 tensors on one device, in stream order.

    The tensors have the values of the file, bit-identical on every device; torch computes `scales`
    and `opacities` from them.

    Attributes
    ----------
    means : Tensor, shape (N, 3)
        Centres.
    quats : Tensor, shape (N, 4)
        Quaternions wxyz: unit quaternions with profiles ``l``, ``m`` and ``s``, otherwise as
        stored.
    log_scales : Tensor, shape (N, 3)
        Natural logarithms of standard deviations.
    logits : Tensor, shape (N,)
        Opacities before the sigmoid.
    sh : Tensor, shape (N, 1 + K, 3)
        SH-DC, then the K = 0, 3, 8, 15 coefficients of SH-AC; R, G, B.

    Examples
    --------
    >>> splats = gs_codec.decode_tensors("scene.egs", device="cpu")
    >>> bool((splats.scales > 0).all()), splats.opacities.shape
    (True, torch.Size([2000]))
    >>> import dataclasses
    >>> opaque = dataclasses.replace(splats, logits=splats.logits + 1)
    >>> len(gs_codec.encode_tensors(opaque)) > 1000
    True
    """

    means: torch.Tensor
    quats: torch.Tensor
    log_scales: torch.Tensor
    logits: torch.Tensor
    sh: torch.Tensor

    @property
    def scales(self) -> torch.Tensor:
        """Standard deviations along the axes, ``(N, 3)``."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> torch.Tensor:
        """Opacities from 0 to 1, ``(N,)``."""
        return self.logits.sigmoid()


@checked
def decode_tensors(source: bytes | str | Path, device: str = "cuda") -> Splats:
    """Decode an `.egs` file or stream to tensors on a device.

    Profiles ``l``, ``m`` and ``s`` are decoded on a CUDA device. Files of other profiles, and files
    with far Gaussians, are decoded on the CPU and copied to the device.

    Parameters
    ----------
    source : bytes, str or Path
        A stream, or the path of a file.
    device : str
        ``cuda``, ``cuda:1``..., or ``cpu``.

    Returns
    -------
    Splats
        The same values as from `decode`, bit for bit.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or the device type is unknown.
    CorruptStream, TruncatedStream, UnsupportedVersion
        As in `decode`.
    MissingTool, ToolFailed
        If torch, or for ``cuda`` numba-cuda or a device, is missing; or as in `decode`.

    Examples
    --------
    >>> splats = gs_codec.decode_tensors("scene.egs", device="cpu")
    >>> splats.means.shape, splats.opacities.shape, splats.sh.shape
    (torch.Size([2000, 3]), torch.Size([2000]), torch.Size([2000, 16, 3]))

    Render with gsplat, with ``device="cuda"``::

        shapes = splats.means, splats.quats, splats.scales
        gsplat.rasterization(*shapes, splats.opacities, splats.sh, views, lenses, 800, 532)
    """
    require_device(device)
    if isinstance(source, bytes):
        return _decode(choose_part(source, Part()), device)
    with opened_slabs(source, Part()) as slabs, located(Path(source)):
        return _decode(slabs.chosen, device)


@checked
def encode_tensors(splats: Splats, config: Config | str | None = None) -> bytes:
    """Encode torch tensors of Gaussians as an `.egs` stream, on the CPU.

    `decode_tensors` is the inverse.

    Parameters
    ----------
    splats : Splats
        Tensors on any device; `log_scales` and `logits` are a trainer's values before activation.
    config : Config or str, optional
        A configuration or the name of a profile, by default ``m``.

    Returns
    -------
    bytes
        The same stream as from `encode` without a plan, byte for byte.

    Raises
    ------
    InvalidInput
        If the shape of a tensor is wrong (see `Splats`); if the configuration has another format or
        coarser levels; or as in `encode`.
    MissingTool, ToolFailed
        As in `encode`.

    Examples
    --------
    >>> splats = gs_codec.decode_tensors("scene.egs", device="cpu")
    >>> data = gs_codec.encode_tensors(splats)
    >>> gs_codec.inspect(data).count
    2000
    """
    config = as_config(config)
    if config.format != EGS or config.lod:
        name = "lod" if config.lod else f"format '{config.format}'"
        raise InvalidInput(
            f"{name}: cannot be encoded from tensors, expected .egs without coarser levels"
        )
    tensors = named_tensors(splats)
    scene = scene_of_tensors({name: array_of(each) for name, each in tensors.items()})
    if config.profile != LOSSLESS:
        scene = with_finite_ends(scene)
    return b"".join(encode(scene, Request(config))[0])


def named_tensors(splats: Splats) -> dict[str, torch.Tensor]:
    """The tensors before activation, with gsplat's names."""
    return {
        "means": splats.means, "quats": splats.quats, "scales": splats.log_scales,
        "opacities": splats.logits, "sh0": splats.sh[:, :1], "shN": splats.sh[:, 1:],
    }  # fmt: skip


def require_device(device: str) -> None:
    """Check that a device and the packages for it are available."""
    kind, _, number = device.partition(":")
    if kind not in ("cpu", "cuda") or (number and not (kind == "cuda" and number.isdecimal())):
        raise InvalidInput(f"device '{device}': expected cpu, cuda, cuda:1...")
    torch = needed("torch", f"device '{device}'")
    if kind == "cpu" or config.ENABLE_CUDASIM:
        return
    if int(number or 0) >= torch.cuda.device_count():
        raise MissingTool(f"device '{device}': torch sees {torch.cuda.device_count()} CUDA devices")
    if not (is_available("numba_cuda") and _is_complete()):
        raise missing_package("numba_cuda", f"device '{device}'")


def _is_complete() -> bool:
    """Whether numba finds the driver and the toolkit."""
    from numba import cuda

    return bool(cuda.is_available())


def _decode(chosen: ChosenPart, device: str) -> Splats:
    header = chosen.file.header
    # Kernels do not support far Gaussians.
    by_kernels = header.profile in ADAPTIVE_PROFILES and Feature.FAR not in header.features
    if device != "cpu" and by_kernels:
        from gs_codec.codecs.cuda.decode import decode_blocks

        carried(chosen.file)  # also detects damage there
        return Splats(**decode_blocks(chosen.file, device))
    import torch

    (scene,) = chosen.slabs(header.count)
    rest = scene.f_rest.reshape(3, SH_COEFFICIENTS[scene.sh_degree], scene.count)
    sh = torch.cat([torch.from_numpy(x) for x in (scene.f_dc[:, None], rest)], 1).permute(2, 1, 0)
    rows = scene.positions.T, scene.rot.T, scene.log_scale.T, scene.opacity[0]
    place = "cpu" if config.ENABLE_CUDASIM else device
    tensors = [torch.from_numpy(row) for row in rows]
    return Splats(*(each.to(place).contiguous() for each in (*tensors, sh)))
