"""Trial encodings of a scene: settings, files, and measured quality of views."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import gs_codec
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.files.encode_file import encode_requested
from gs_codec.files.suffixes import check_no_source
from gs_codec.files.writing import write_parts
from gs_codec.metrics.comparison import Comparison
from gs_codec.metrics.views import compare_views
from gs_codec.report import EncodeReport
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.views.find import find_cameras
from viewer.scenes.opened import Opened, Progress, open_scene

#: Targets for profiles `l`, `m` and `s`: step sizes as multiples of the profile's, bytes, bits per
#: Gaussian, or loss of views in dB.
WISHES = ("steps", "size", "bits", "loss")

#: Range of step sizes, relative to the profile's.
_STEPS = (0.25, 4.0)

#: Range of losses of views, dB.
_LOSSES = (0.01, 1.0)

#: Range of file sizes, as shares of the raw size.
_SHARES = (1 / 200, 1 / 4)

#: Initial target values: step sizes, share of the raw size, and loss in dB.
_STEP = 1.0
_SHARE = 1 / 20
_LOSS = 0.05


@dataclass(frozen=True)
class EncodingSettings:
    """Settings of a trial encoding.

    Attributes
    ----------
    profile : str
        One of gs_codec's profiles.
    wish : str
        One of `WISHES`.
    value : float
        Value of the target: a factor, bytes, bits, or dB.
    guided : bool
        Whether cameras guide the encoder; always for ``loss``.
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
        says_guided = self.guided and self.wish != "loss"
        return self.profile + amounts[self.wish] + (" guided" if says_guided else "")

    @property
    def config(self) -> gs_codec.Config:
        """The encoder's configuration; drops extra properties, which are not shown."""
        coarseness = self.value if self.wish == "steps" else 1.0
        return gs_codec.Config(
            self.profile,
            nonfinite="error" if self.profile == LOSSLESS else "drop",
            extra="drop",
            coarseness=coarseness,
        )

    @property
    def rate(self) -> gs_codec.RateTarget | None:
        """The encoder's rate target."""
        if self.wish == "size":
            return gs_codec.RateTarget(size=int(self.value))
        if self.wish == "bits":
            return gs_codec.RateTarget(bits=self.value)
        return gs_codec.RateTarget(psnr_drop=self.value) if self.wish == "loss" else None

    def request(self, cameras: Sequence[gs_codec.Camera], max_bytes: int | None = None) -> Request:
        """The request of the encoder, with `cameras` as its views, or estimated ones if empty."""
        plan = None
        if self.guided or self.wish == "loss":
            plan = gs_codec.Plan(cameras=list(cameras) or "auto")
        return Request(self.config, plan, self.rate, max_bytes=max_bytes)


@dataclass
class Scale:
    """A target's value, and the range of its slider; a size is in MB."""

    value: float
    low: float
    high: float

    @property
    def within(self) -> float:
        """The value clamped to the slider's range."""
        return min(max(self.value, self.low), self.high)


def scales_of(scene: Opened) -> dict[str, Scale]:
    """The scale of each of `WISHES` for a scene."""
    raw = scene.raw_bytes
    units = {"size": raw / 1e6, "bits": 8 * raw / max(scene.count, 1)}
    found = {name: Scale(_SHARE * u, *(s * u for s in _SHARES)) for name, u in units.items()}
    return found | {"steps": Scale(_STEP, *_STEPS), "loss": Scale(_LOSS, *_LOSSES)}


def has_steps(profile: str) -> bool:
    """Whether a profile has step sizes, which targets and cameras can change."""
    return profile in ADAPTIVE_PROFILES


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial encoding of a scene.

    Attributes
    ----------
    number : int
        Number of the trial, from 1.
    settings : EncodingSettings
    path : Path
        A temporary file.
    report : gs_codec's EncodeReport
    quality : gs_codec's Comparison or None
        Quality of held-out views against the source; None until measured.
    """

    number: int
    settings: EncodingSettings
    path: Path
    report: EncodeReport
    quality: Comparison | None = None

    @property
    def name(self) -> str:
        """Its number and its settings."""
        return f"#{self.number} {self.settings}"

    @property
    def bits(self) -> float:
        """Bits per Gaussian of the file."""
        return 8 * self.report.file_bytes / max(self.report.count, 1)

    def open(self, progress: Progress | None = None, max_bytes: int | None = None) -> Opened:
        """Decode it."""
        opened = open_scene(self.path, progress=progress, max_bytes=max_bytes)
        return replace(opened, name=self.name)


class Trials:
    """A scene and its trial encodings in temporary files.

    `encode` and `measure` run in a background thread, everything else in the window's thread.

    Parameters
    ----------
    source : Opened
    folder : Path
        Folder for the files; its creator removes it.
    cameras : sequence of gs_codec's Camera
        Given cameras; if empty, cameras are estimated.
    max_bytes : int, optional
        As in `gs_codec.read`.

    Attributes
    ----------
    all : list of Trial
        All trials, earliest first.
    """

    def __init__(
        self,
        source: Opened,
        folder: Path,
        cameras: Sequence[gs_codec.Camera] = (),
        max_bytes: int | None = None,
    ) -> None:
        self.source, self.cameras, self.max_bytes = source, cameras, max_bytes
        self.all: list[Trial] = []
        self.folder = Path(tempfile.mkdtemp(dir=folder))
        self._begun = 0
        self._held_out: tuple[Sequence[gs_codec.Camera] | None, list[gs_codec.Camera]] = None, []

    def look_from(self, cameras: Sequence[gs_codec.Camera]) -> None:
        """Use other cameras, and discard results measured with the previous ones."""
        if list(cameras) != list(self.cameras):
            self.cameras = cameras
            self.all = [replace(tried, quality=None) for tried in self.all]

    def encode(
        self, settings: EncodingSettings, progress: Progress | None = None
    ) -> tuple[Trial, Opened]:
        """Encode the scene, and decode the result; `progress` may raise to stop it.

        Raises
        ------
        gs_codec.GsCodecError
            If `gs_codec.encode_file` fails, or the file has changed since it was opened.
        """
        self._begun += 1
        path = self.folder / f"{self._begun}.egs"
        try:
            report = self._write(path, settings, progress)
            done = Trial(len(self.all) + 1, settings, path, report)
            return done, done.open(progress, self.max_bytes)
        except BaseException:
            with suppress(OSError):
                path.unlink()
            raise

    def _write(
        self, path: Path, settings: EncodingSettings, progress: Progress | None
    ) -> EncodeReport:
        """Encode the file of the scene, or the shown scene if that differs from the file."""
        request = settings.request(self.cameras, self.max_bytes)
        if self.source.is_stored:
            self.source.check_unchanged()
            return encode_requested(self.source.path, path, request, progress, overwrite=True)
        scene = self.source.gaussians
        parts, report = encode(scene, request, progress, scene.float_bytes)
        write_parts(path, parts)
        return report

    def measure(
        self, tried: Trial, opened: Opened | None = None, progress: Progress | None = None
    ) -> Comparison:
        """Compare held-out views of a trial with the source, like ``gs-codec compare``.

        Uses the cameras marked as held out; if none are, all cameras; without cameras, estimated
        ones. `opened` is the decoded trial, if available.

        Raises
        ------
        gs_codec.GsCodecError
        """
        first, cameras = self.source.gaussians, self.cameras
        if self._held_out[0] is not cameras:
            source = list(cameras) or "auto"
            self._held_out = cameras, find_cameras(source, first, "held-out", progress=progress)
        opened = opened or tried.open(progress, self.max_bytes)
        return compare_views(first, opened.gaussians, self._held_out[1], progress=progress)

    def add(self, tried: Trial) -> None:
        """Add a trial, or update it with its quality."""
        self.all[tried.number - 1 : tried.number] = [tried]

    def save(self, tried: Trial, path: Path) -> None:
        """Copy the file of a trial.

        Raises
        ------
        gs_codec.GsCodecError
            If `path` cannot be written, is the file of the source, or does not end in ``.egs``.
        """
        check_no_source(self.source.paths, path)
        if path.suffix.lower() != ".egs":
            raise gs_codec.GsCodecError(f"{path}: expected a name that ends in .egs")
        with tried.path.open("rb") as source, atomic_writer(path) as target:
            shutil.copyfileobj(source, target)
