"""Encodings of a scene that were tried: what was asked for, the files, and what views lose."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import gs_codec
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS
from gs_codec.encoding.order import encode_by_plan
from gs_codec.files.coding import encode_file
from gs_codec.files.scenes import write_parts
from gs_codec.metrics.attributes import Comparison
from gs_codec.metrics.views import compare_views
from gs_codec.report import EncodeReport
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.views.find import find_cameras
from viewer.scenes.opened import Opened, Progress, open_scene

#: What profiles `l`, `m` and `s` can be asked for: step sizes as multiples of the profile's, bytes,
#: bits per Gaussian, or the loss of views in dB.
WISHES = ("steps", "size", "bits", "loss")


@dataclass(frozen=True)
class Asked:
    """How a scene is to be encoded.

    Attributes
    ----------
    profile : str
        One of gs_codec's profiles.
    wish : str
        One of `WISHES`.
    value : float
        Of the wish: a factor, bytes, bits, or dB.
    guided : bool
        Whether cameras guide the encoder; they do for every ``loss``.
    """

    profile: str = "m"
    wish: str = "steps"
    value: float = 1.0
    guided: bool = False

    def __str__(self) -> str:
        amounts = {
            "steps": "" if self.value == 1 else f" x{self.value:.3g}",
            "size": f" {self.value / 1e6:.4g} MB",
            "bits": f" {self.value:.4g} bits",
            "loss": f" {self.value:.3g} dB",
        }
        told = self.guided and self.wish != "loss"
        return self.profile + amounts[self.wish] + (" guided" if told else "")

    @property
    def config(self) -> gs_codec.Config:
        """The encoder's configuration; properties beyond the layout are not shown, nor encoded."""
        coarseness = self.value if self.wish == "steps" else 1.0
        return gs_codec.Config(
            self.profile,
            nonfinite="error" if self.profile == LOSSLESS else "drop",
            extra="drop",
            coarseness=coarseness,
        )

    @property
    def rate(self) -> gs_codec.RateTarget | None:
        """The encoder's target."""
        if self.wish == "size":
            return gs_codec.RateTarget(size=int(self.value))
        if self.wish == "bits":
            return gs_codec.RateTarget(bits=self.value)
        return gs_codec.RateTarget(psnr_drop=self.value) if self.wish == "loss" else None

    def plan(self, cameras: Sequence[gs_codec.Camera]) -> gs_codec.Plan | None:
        """The encoder's views: `cameras`, or estimated ones if there are none."""
        if not self.guided and self.wish != "loss":
            return None
        return gs_codec.Plan(cameras=list(cameras) or "auto")


def has_steps(profile: str) -> bool:
    """Whether a profile has step sizes, which wishes and cameras change."""
    return profile in ADAPTIVE_PROFILES


@dataclass(frozen=True, eq=False)
class Try:
    """An encoding of a scene.

    Attributes
    ----------
    number : int
        From 1.
    asked : Asked
    path : Path
        A temporary file.
    report : gs_codec's EncodeReport
    quality : gs_codec's Comparison or None
        Of held-out views against the source; None until measured.
    """

    number: int
    asked: Asked
    path: Path
    report: EncodeReport
    quality: Comparison | None = None

    @property
    def name(self) -> str:
        """Its number, and what was asked for."""
        return f"#{self.number} {self.asked}"

    @property
    def bits(self) -> float:
        """Bits per Gaussian of the file."""
        return 8 * self.report.file_bytes / max(self.report.count, 1)

    def open(self, progress: Progress | None = None, max_bytes: int | None = None) -> Opened:
        """Decode it."""
        opened = open_scene(self.path, progress=progress, max_bytes=max_bytes)
        return replace(opened, name=self.name)


class Tries:
    """A scene, and its encodings in temporary files.

    `encode` and `measure` run in one background thread; the rest is of the window's thread.

    Parameters
    ----------
    source : Opened
    folder : Path
        Where files are made; who made it removes it.
    cameras : sequence of gs_codec's Camera
        Those that were given; estimated ones are used if there are none.
    max_bytes : int, optional
        As for `gs_codec.read`.

    Attributes
    ----------
    all : list of Try
        The earliest first.
    """

    def __init__(
        self,
        source: Opened,
        folder: Path,
        cameras: Sequence[gs_codec.Camera] = (),
        max_bytes: int | None = None,
    ) -> None:
        self.source, self.cameras, self.max_bytes = source, cameras, max_bytes
        self.all: list[Try] = []
        self.folder = Path(tempfile.mkdtemp(dir=folder))
        self._begun = 0
        self._held_out: tuple[Sequence[gs_codec.Camera] | None, list[gs_codec.Camera]] = None, []

    def look_from(self, cameras: Sequence[gs_codec.Camera]) -> None:
        """Use other cameras; what others measured is forgotten."""
        if list(cameras) != list(self.cameras):
            self.cameras = cameras
            self.all = [replace(tried, quality=None) for tried in self.all]

    def encode(self, asked: Asked, progress: Progress | None = None) -> tuple[Try, Opened]:
        """Encode the scene, and decode the result; `progress` may raise to stop it.

        Raises
        ------
        gs_codec.GsCodecError
            As `gs_codec.encode_file` does; or if the file changed after it was opened.
        """
        self._begun += 1
        path = self.folder / f"{self._begun}.egs"
        try:
            report = self._write(path, asked, progress)
            done = Try(len(self.all) + 1, asked, path, report)
            return done, done.open(progress, self.max_bytes)
        except BaseException:
            with suppress(OSError):
                path.unlink()
            raise

    def _write(self, path: Path, asked: Asked, progress: Progress | None) -> EncodeReport:
        """Encode the file of the scene or, if it is not what is shown, what is."""
        config, plan, rate = asked.config, asked.plan(self.cameras), asked.rate
        if self.source.is_stored:
            self.source.check_unchanged()
            return encode_file(
                self.source.path, path, config, plan, rate, progress=progress,
                max_bytes=self.max_bytes, overwrite=True,
            )  # fmt: skip
        scene = self.source.gaussians
        data, report = encode_by_plan(scene, scene.float_bytes, config, plan, rate, progress)
        write_parts(path, [data])
        return replace(report, ratio=scene.float_bytes / report.file_bytes)

    def measure(
        self, tried: Try, opened: Opened | None = None, progress: Progress | None = None
    ) -> Comparison:
        """Compare held-out views of a try and the source, as ``gs-codec compare`` does.

        Views are those of the cameras that are marked so, of all cameras if none is, or estimated.
        `opened` is the try, if it is open.

        Raises
        ------
        gs_codec.GsCodecError
        """
        first, cameras = self.source.gaussians, self.cameras
        if self._held_out[0] is not cameras:
            asked = list(cameras) or "auto"
            self._held_out = cameras, find_cameras(asked, first, "held-out", progress=progress)
        opened = opened or tried.open(progress, self.max_bytes)
        return compare_views(first, opened.gaussians, self._held_out[1], progress=progress)

    def add(self, tried: Try) -> None:
        """Keep a try, or the same try with its quality."""
        self.all[tried.number - 1 : tried.number] = [tried]

    def save(self, tried: Try, path: Path) -> None:
        """Copy the file of a try.

        Raises
        ------
        gs_codec.GsCodecError
            If it cannot be written, or is not named ``.egs``.
        """
        if path.suffix.lower() != ".egs":
            raise gs_codec.GsCodecError(f"{path}: expected a name that ends in .egs")
        with tried.path.open("rb") as source, atomic_writer(path) as target:
            shutil.copyfileobj(source, target)
