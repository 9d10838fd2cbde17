"""A compression strategy for gsplat's trainer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.api.splats import decode_tensors, named_tensors
from gs_codec.api.trainer_tensors import scene_of_trainer
from gs_codec.config import EGS, Config, as_config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.files.writing import tell_lost, write_parts
from gs_codec.plan import Plan
from gs_codec.runtime.arguments import check_fields

if TYPE_CHECKING:
    from torch import Tensor

#: Name of the file in a trainer's folder.
_NAME = "splats.egs"


@dataclass(frozen=True)
class Compression:
    """Compresses splats in gsplat's ``simple_trainer.py``, with the methods of `PngCompression`.

    Parameters
    ----------
    config : Config or str
        A configuration or the name of a profile.
    plan : Plan, optional
        Views that guide the encoder, and steps of preparation, as in `encode`.

    Raises
    ------
    InvalidInput
        If `config` is not a configuration for ``.egs``, or not possible together with `plan`.

    Examples
    --------
    >>> splats = gs_codec.to_tensors(gs_codec.read("scene.ply"), "torch")
    >>> compression = gs_codec.Compression("s")
    >>> compression.compress(".", splats)
    >>> list(compression.decompress("."))
    ['means', 'quats', 'scales', 'opacities', 'sh0', 'shN']
    """

    config: Config | str = "m"
    plan: Plan | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self._request.config.format != EGS:
            raise InvalidInput(f"format '{self._request.config.format}': expected '{EGS}'")

    @property
    def _request(self) -> Request:
        return Request(as_config(self.config), self.plan)

    def compress(self, compress_dir: str | Path, splats: Mapping[str, Any]) -> None:
        """Write ``splats.egs`` to a folder, replacing an earlier one.

        Parameters
        ----------
        compress_dir : str or Path
            An existing folder.
        splats : mapping of str to array or tensor
            The trainer's parameters, as in `from_tensors`.

        Raises
        ------
        InvalidInput
            As in `from_tensors` and `encode`; or if the file cannot be written.
        """
        parts, report = encode(scene_of_trainer(splats), self._request)
        path = Path(compress_dir) / _NAME
        write_parts(path, parts)
        tell_lost(path, report.lost)

    def decompress(self, compress_dir: str | Path) -> dict[str, Tensor]:
        """Read the splats that `compress` wrote, in the order of the file.

        Parameters
        ----------
        compress_dir : str or Path
            The folder.

        Returns
        -------
        dict of str to Tensor
            Float32 tensors on the CPU, with the names and shapes of `to_tensors`. Their order is
            not the trainer's: start new optimisers before training them further.

        Raises
        ------
        InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
            As in `decode`.
        MissingTool
            If torch is not installed.
        """
        return named_tensors(decode_tensors(Path(compress_dir) / _NAME, "cpu"))
