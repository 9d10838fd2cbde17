"""The window's inspection for a page: pictures, photographs and trial encodings on this machine."""

from __future__ import annotations

import io
import json
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import astuple
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.image_files import find_image
from gs_codec.cameras.inria import as_camera
from gs_codec.cameras.json_fields import as_list, as_numbers, as_object, as_pixels, as_text, get
from gs_codec.cli.main import describe_error
from gs_codec.config import ADAPTIVE_PROFILES, PROFILE_CHOICES
from gs_codec.errors import InvalidInput
from gs_codec.files.sharing import is_read_by_pages
from gs_codec.views.photographs import read_photograph
from viewer.pictures.drawer import Drawer, measure
from viewer.pictures.layers import Legend
from viewer.pictures.picture import Shown, draw_scene, reasons_text, to_pillow
from viewer.scenes.choice import Appearance, OctreeChoice
from viewer.scenes.numbers import quality_text
from viewer.scenes.opened import Opened, Progress, Pruned
from viewer.scenes.pose import Pose, of_camera
from viewer.scenes.trial_jobs import TrialJobs
from viewer.scenes.trial_list import WISHES, EncodingSettings, Trial, Trials, scales_of
from viewer.scenes.view_request import Request, find_pruned, find_views
from viewer.scenes.viewpoints import Views
from viewer.scenes.worker import Worker

#: Maximum side of a picture, pixels.
_MAX_SIDE = 2048

#: Quality of JPEG pictures, 0-95.
_QUALITY = 92

#: Number of colours that describe the bar of a heat map.
_COLOURS = 9

#: The content type, the bytes, and facts about them.
Answer = tuple[str, bytes, Mapping[str, object]]


class Inspector:
    """Answers a page that inspects a request; the scenes are opened for the first answer.

    Pictures are drawn one after another, and encodings too; threads may ask at once.

    Parameters
    ----------
    request : Request

    Attributes
    ----------
    address : str
        Where the page sends its calls; that of another inspection differs.
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self.address = f"inspect-{secrets.token_hex(4)}"
        self._files = TemporaryDirectory(prefix="gs-viewer-", ignore_cleanup_errors=True)
        self._opening, self._drawing, self._changing = (threading.RLock() for _ in range(3))
        self._newest: Counter[str] = Counter()
        self._scenes: list[Opened] = []
        self._views = Views()
        self._pruned: Pruned | None = None
        self._drawers: dict[Opened, Drawer] = {}
        self._last = Shown(())
        self._trial: tuple[int, Opened] | None = None
        self._readable: set[int] = set()  # trials
        self._error = ""
        self._worker = Worker(self._now)
        self._jobs = TrialJobs(self._worker, lambda: None, self._failed)
        self._calls: dict[str, Callable[[dict], Answer | None]] = {
            "facts": self._facts,
            "picture": self._picture,
            "quality": self._quality,
            "photograph": self._photograph,
            "encode": self._encode,
            "cancel": self._cancel,
            "progress": self._progress,
        }

    @property
    def is_open(self) -> bool:
        """Whether the scenes are open."""
        return bool(self._scenes)

    def open(self, progress: Progress | None = None) -> list[Opened]:
        """Open the scenes, unless they are.

        Raises
        ------
        gs_codec.GsCodecError
        """
        with self._opening:
            if not self._scenes:
                scenes = self._request.scenes(progress)
                self._pruned = find_pruned(self._request, scenes[0])
                if not self._request.chosen:
                    self._views = find_views(self._request, scenes[0])
                self._scenes = scenes
            return self._scenes

    def answer(self, asked: object) -> Answer | None:
        """Answer a call of the page; None if a newer call for a picture replaces it.

        Raises
        ------
        gs_codec.GsCodecError
        """
        call = as_object("request", asked, "a call")
        known = self._calls.get(as_text("request", "call", get("request", call, "call")))
        if known is None:
            raise InvalidInput(f"request: expected one of {', '.join(self._calls)}")
        return known(call)

    def trial(self, number: int) -> Trial | None:
        """A finished trial, by its number from 1."""
        trials = self._jobs.trials
        return trials.all[number - 1] if trials and 0 < number <= len(trials.all) else None

    def close(self) -> None:
        """Stop encoding, and remove the temporary files."""
        self._worker.end()
        self._files.cleanup()

    # Pictures

    def _facts(self, asked: dict) -> Answer:
        """What the page can choose from, and its first choices."""
        request, [first, *_] = self._request, self.open()
        return _json(
            layers=request.layers,
            colouring=request.colouring,
            scale=request.scale,
            depth=request.octree.depth,
            cells=request.octree.colouring,
            second=request.b is not None,
            pruned=self._pruned is not None,
            photographs=request.images is not None,
            profiles=PROFILE_CHOICES,
            stepped=[*ADAPTIVE_PROFILES],
            scales={name: astuple(scale) for name, scale in scales_of(first).items()},
        )

    def _pair(self, asked: dict) -> list[Opened]:
        """The scenes that the page shows: the first and, if any, a second or a trial."""
        scenes, number = self.open(), as_pixels("request", "trial", get("request", asked, "trial"))
        if not number:
            return scenes
        tried = self.trial(number)
        if tried is None:
            raise InvalidInput(f"request: no trial {number}")
        if self._trial is None or self._trial[0] != number:
            self._trial = number, tried.open(max_bytes=self._request.max_bytes)
        return [scenes[0], self._trial[1]]

    def _picture(self, asked: dict) -> Answer | None:
        """A picture of one of the scenes, as JPEG, with its legends."""
        number = as_pixels("request", "scene", get("request", asked, "scene"))
        wide, high = (as_pixels("request", key, get("request", asked, key)) for key in ("w", "h"))
        if number not in (0, 1) or not (0 < wide <= _MAX_SIDE and 0 < high <= _MAX_SIDE):
            raise InvalidInput(f"request: expected scene 0 or 1, and sides of 1 to {_MAX_SIDE}")
        pose = _pose(asked)

        def draw() -> Answer:
            scenes = self._pair(asked)
            if number >= len(scenes):
                raise InvalidInput("request: there is no second scene")
            shown = self._shown(asked, scenes)
            image, legends = draw_scene(scenes[number], pose, wide, high, shown, self._drawers)
            has_pruned = "pruned" in shown.layers and shown.pruned is not None and number == 0
            reasons = reasons_text(shown.pruned) if has_pruned and shown.pruned else []
            caption, scene = shown.captions[number], scenes[number]
            remark = "" if caption.endswith(f": {scene.title}") else caption
            return "image/jpeg", _jpeg(image), {
                "remark": remark,
                "legends": [_described(legend) for legend in legends],
                "reasons": [(text, _css(colour)) for text, colour in reasons],
            }  # fmt: skip

        return self._in_turn(f"picture {number}", draw)

    def _shown(self, asked: dict, scenes: list[Opened]) -> Shown:
        """What the page asks for; the last object again if nothing differs, with what it caches."""
        layers = [
            as_text("request", "layer", name)
            for name in as_list("request", "layers", asked.get("layers"))
        ]
        colouring, cells = (
            as_text("request", key, get("request", asked, key)) for key in ("colouring", "cells")
        )
        scale = asked.get("scale")
        depth, degree = (
            as_pixels("request", key, get("request", asked, key)) for key in ("depth", "degree")
        )
        if not 0 <= degree <= 3:
            raise InvalidInput(f"request: degree {degree}, expected 0 to 3")
        octree = OctreeChoice(depth, cells)
        Request(layers=tuple(layers), colouring=colouring, octree=octree, scale=scale).check()
        shown = Shown(
            tuple(layers), colouring, tuple(scenes), self._pruned, octree,
            Appearance(degree, background=_background(asked)), scale=scale,
        )  # fmt: skip
        if shown != self._last:
            self._last = shown
            self._drawers = {s: self._drawers[s] for s in scenes if s in self._drawers}
        return self._last

    def _quality(self, asked: dict) -> Answer | None:
        """How much the second scene differs from the first in the camera's frame."""
        pose = _pose(asked)

        def draw() -> Answer:
            scenes = self._pair(asked)
            return _json(text=measure(self._drawers, scenes, pose) if len(scenes) > 1 else "")

        return self._in_turn("quality", draw)

    def _photograph(self, asked: dict) -> Answer | None:
        """The photograph of a camera, by its index, as JPEG."""
        self.open()
        number = as_pixels("request", "view", get("request", asked, "view"))
        if self._request.images is None or not 0 <= number < len(self._views.cameras):
            raise InvalidInput("request: there is no such photograph")
        camera = self._views.cameras[number]
        path, background = find_image(self._request.images, camera.name), _background(asked)
        return self._in_turn(
            "photograph",
            lambda: ("image/jpeg", _jpeg(read_photograph(camera, path, background)[1]), {}),
        )

    def _in_turn(self, kind: str, draw: Callable[[], Answer]) -> Answer | None:
        """Draw when nothing else is drawn, unless the same kind is asked for again until then."""
        with self._changing:
            self._newest[kind] += 1
            number = self._newest[kind]
        with self._drawing:
            if number != self._newest[kind]:
                return None
            return draw()

    # Trial encodings

    def _encode(self, asked: dict) -> Answer:
        """Begin a trial encoding of the first scene, instead of one that runs."""
        [first, *_] = self.open()
        profile, wish = (
            as_text("request", key, get("request", asked, key)) for key in ("profile", "wish")
        )
        [value] = as_numbers("request", "value", [asked.get("value")], 1)
        if profile not in PROFILE_CHOICES or wish not in WISHES or value <= 0:
            raise InvalidInput("request: no such encoding")
        settings = EncodingSettings(profile)
        if profile in ADAPTIVE_PROFILES:
            is_guided = asked.get("guided") is True or wish == "loss"
            settings = EncodingSettings(profile, wish, value, is_guided)
        with self._changing:
            self._error = ""
            trials = self._jobs.trials or Trials(
                first, Path(self._files.name), self._views.cameras, self._request.max_bytes
            )
            self._jobs.run(trials, settings, self._encoded)
        return self._progress(asked)

    def _encoded(self, tried: Trial, opened: Opened) -> None:
        if opened.info is not None and is_read_by_pages(opened.info):
            self._readable.add(tried.number)
        with self._drawing:
            self._trial = tried.number, opened

    def _cancel(self, asked: dict) -> Answer:
        with self._changing:
            self._jobs.cancel()
        return self._progress(asked)

    def _progress(self, asked: dict) -> Answer:
        """What runs, and the finished trials."""
        with self._changing:
            trials = self._jobs.trials
            doing, finished = self._jobs.doing, [] if trials is None else trials.all
            numbers = [_numbers(tried, tried.number in self._readable) for tried in finished]
            return _json(doing=doing, error=self._error, trials=numbers)

    def _failed(self, error: Exception) -> None:
        self._error = describe_error(error)

    def _now(self, call: Callable[[], None]) -> None:
        """Pass on a result of the worker."""
        with self._changing:
            call()


def _pose(asked: dict) -> Pose:
    return of_camera(as_camera(as_object("request", get("request", asked, "camera"), "a camera")))


def _background(asked: dict) -> tuple[float, float, float]:
    red, green, blue = as_numbers("request", "background", asked.get("background"), 3)
    return red, green, blue


def _json(**facts: object) -> Answer:
    return "application/json", json.dumps(facts, allow_nan=False).encode(), {}


def _jpeg(image: NDArray[np.float32]) -> bytes:
    file = io.BytesIO()
    # Without subsampling of colours, which blurs thin lines and points.
    to_pillow(image).save(file, "JPEG", quality=_QUALITY, subsampling=0)
    return file.getvalue()


def _css(colour: tuple[float, float, float]) -> str:
    return f"rgb({' '.join(str(round(255 * part)) for part in colour)})"


def _described(legend: Legend) -> dict[str, object]:
    """A legend for the page: title, marks, and colours, of which those of a heat map blend."""
    bar = legend.bar(len(legend.kinds) or _COLOURS, 1)[0]
    colours = [_css((red, green, blue)) for red, green, blue in bar.tolist()]
    blends = not legend.kinds
    return {"title": legend.title, "marks": legend.marks, "colours": colours, "blends": blends}


def _numbers(tried: Trial, is_readable: bool) -> dict[str, object]:
    """A trial in the page's list."""
    report, quality = tried.report, tried.quality
    found: dict[str, object] = {
        "number": tried.number,
        "name": tried.name,
        "bytes": report.file_bytes,
        "ratio": report.ratio,
        "bits": tried.bits,
        "readable": is_readable,
    }
    if quality is None:
        return found
    return found | {
        "views": len(quality.views),
        "mean": quality_text(quality.mean.between),
        "worst": quality_text(quality.worst.between),
        "where": quality.worst.name,
    }
