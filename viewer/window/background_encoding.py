"""Encode the first scene in the background, and show trial encodings."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from weakref import WeakKeyDictionary

from gs_codec.metrics.comparison import Comparison
from viewer.scenes.opened import Opened, Progress, Pruned
from viewer.scenes.trial_list import EncodingSettings, Trial, Trials
from viewer.window.loading import Loading
from viewer.window.shared import Host
from viewer.window.visits import Visits
from viewer.window.worker import Cancelled, Stale

#: Minimum interval between progress updates, seconds, because drawing the window takes time too.
_PERIOD = 0.2


class Encoding:
    """The trial encodings of a window, and the jobs that make and measure them.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    loading : Loading
    changed : callable
        Called when `doing` changes.

    Attributes
    ----------
    worker : Worker
        Runs long jobs, so that pictures need not wait.
    trials : Trials or None
        None until the first encoding.
    doing : tuple of str and float, or None
        Current step and its progress, 0-1; None if idle.
    encodes : bool
        Whether a scene is being encoded.
    """

    def __init__(
        self, viewer: Host, visits: Visits, loading: Loading, changed: Callable[[], None]
    ) -> None:
        self._viewer, self._visits, self._loading = viewer, visits, loading
        self._changed = changed
        self.worker = viewer.worker.another()
        self.trials: Trials | None = None
        self.doing: tuple[str, float] | None = None
        self.encodes = False
        # Trials as decoded, neither edited nor turned.
        self._opened: WeakKeyDictionary[Opened, int] = WeakKeyDictionary()
        self._pruned: Pruned | None = None
        self._files: tempfile.TemporaryDirectory[str] | None = None

    def encode(self, settings: EncodingSettings) -> None:
        """Encode the first scene or, if it is a trial, its source; the result becomes B."""
        trials = self._begin()

        def job(stale: Stale) -> tuple[Trial, Opened]:
            return trials.encode(settings, self._progress(stale, "encoding"))

        def done(found: tuple[Trial, Opened]) -> None:
            tried, opened = found
            trials.add(tried)
            self._opened[opened] = tried.number
            first = self._viewer.stage.scenes[0]
            self.encodes = False
            if first in self._opened:
                self._put([first, opened])
            self._measure(opened)

        def failed(error: Exception) -> None:
            self.encodes = False
            self._measure()
            self._viewer.fail(error)

        self.worker.cancel("measure")
        self.encodes = True
        self._do("encoding", 0.0)
        self.worker.submit("encode", job, done, failed)

    def _begin(self) -> Trials:
        """The trials of the scene shown; a new scene starts with none."""
        viewer = self._viewer
        scene, views = viewer.stage.scenes[0], self._visits.views
        cameras = () if views.chosen else views.cameras
        if self.trials is None or scene not in self._opened:
            if self._files is None:
                self._files = tempfile.TemporaryDirectory(prefix="gs-viewer-")
            folder, most = Path(self._files.name), viewer.request.max_bytes
            self.trials, self._pruned = Trials(scene, folder, cameras, most), viewer.stage.pruned
            self._opened.clear()
            self._opened[scene] = 0
        self.trials.look_from(cameras)
        return self.trials

    def _measure(self, opened: Opened | None = None) -> None:
        """Measure held-out views of the newest unmeasured trial, then of the other trials.

        `opened` is the newest trial, if it is open.
        """
        trials = self.trials
        left = [] if trials is None else [tried for tried in trials.all if tried.quality is None]
        if trials is None or not left:
            self._do()
            return
        tried = left[-1]

        def job(stale: Stale) -> Comparison:
            return trials.measure(
                tried, opened, self._progress(stale, f"measuring #{tried.number}")
            )

        def done(quality: Comparison) -> None:
            trials.add(replace(tried, quality=quality))
            self._measure()

        def failed(error: Exception) -> None:
            self._do()
            self._viewer.fail(error)

        self._do(f"measuring #{tried.number}", 0.0)
        self.worker.submit("measure", job, done, failed)

    def cancel(self) -> None:
        """Stop encoding or measuring; the scenes shown stay."""
        for kind in ("encode", "measure"):
            self.worker.cancel(kind)
        self.encodes = False
        self._do()

    def _do(self, text: str = "", share: float = 0.0) -> None:
        self.doing = (text, share) if text else None
        self._changed()

    def _progress(self, stale: Stale, what: str) -> Progress:
        """Progress callback of a job; ends the job if its result is no longer wanted."""
        shown_at = 0.0

        def progress(stage: str, done: int, total: int) -> None:
            nonlocal shown_at
            if stale():
                raise Cancelled
            if time.monotonic() - shown_at > _PERIOD:
                shown_at = time.monotonic()
                self.worker.progress(stale, partial(self._do, f"{what}: {stage}"))(
                    stage, done, total
                )

        return progress

    # Trial encodings

    @property
    def scenes(self) -> Sequence[Trial | Opened]:
        """The source, and then the trials; empty if nothing was encoded."""
        return [] if self.trials is None else [self.trials.source, *self.trials.all]

    def letters(self, number: int) -> str:
        """Panes that show one of `scenes`: A, B, both, or none."""
        shown = [self._opened.get(scene) for scene in self._viewer.stage.scenes]
        return "".join(letter for letter, k in zip("AB", shown, strict=False) if k == number)

    def show(self, number: int, pane: int) -> None:
        """Show one of `scenes` as A or B (0 or 1)."""
        viewer, chosen = self._viewer, self.scenes[number]

        def put(opened: Opened) -> None:
            self._opened[opened] = number
            before = viewer.stage.scenes
            self._put([opened, *before[1:]] if pane == 0 else [before[0], opened])

        if isinstance(chosen, Opened):
            put(chosen)
            return

        def job(stale: Stale) -> Opened:
            progress = viewer.worker.progress(stale, viewer.panel.show_progress)
            return chosen.open(progress, viewer.request.max_bytes)

        viewer.panel.say(f"decoding {chosen.name} ...", progress=0)
        viewer.worker.submit("load", job, put, viewer.fail)

    def _put(self, scenes: list[Opened]) -> None:
        """Show scenes from the present pose; show pruned Gaussians if A is the source."""
        is_source = self.trials is not None and scenes[0] is self.trials.source
        pruned = self._pruned if is_source else None
        self._loading.show(scenes, self._visits.views, pruned, stay=True)

    def save(self, number: int, path: str) -> None:
        """Write the file of a trial, by its number."""
        viewer, trials = self._viewer, self.trials
        if trials is None:
            return
        tried = trials.all[number - 1]

        def done(_: None) -> None:
            viewer.panel.say(f"{Path(path).name} saved")

        viewer.worker.submit(
            "save", lambda stale: trials.save(tried, Path(path)), done, viewer.fail
        )

    def close(self) -> None:
        """Remove the temporary files."""
        if self._files is not None:
            self._files.cleanup()
