"""Encode the first scene in the background, and show trial encodings."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from weakref import WeakKeyDictionary

from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.trial_jobs import TrialJobs
from viewer.scenes.trial_list import EncodingSettings, Trial, Trials
from viewer.scenes.worker import Stale
from viewer.window.loading import Loading
from viewer.window.shared import Host
from viewer.window.visits import Visits


class Encoding(TrialJobs):
    """The trial encodings of a window: of its first scene, shown as its second.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    loading : Loading
    changed : callable
        Called when `doing` changes.
    """

    def __init__(
        self, viewer: Host, visits: Visits, loading: Loading, changed: Callable[[], None]
    ) -> None:
        super().__init__(viewer.worker.another(), changed, viewer.fail)
        self._viewer, self._visits, self._loading = viewer, visits, loading
        # Trials as decoded, neither edited nor turned.
        self._opened: WeakKeyDictionary[Opened, int] = WeakKeyDictionary()
        self._pruned: Pruned | None = None
        self._files: tempfile.TemporaryDirectory[str] | None = None

    def encode(self, settings: EncodingSettings) -> None:
        """Encode the first scene or, if it is a trial, its source; the result becomes B."""

        def show(tried: Trial, opened: Opened) -> None:
            self._opened[opened] = tried.number
            first = self._viewer.stage.scenes[0]
            if first in self._opened:
                self._put([first, opened])

        try:
            trials = self._begin()
        except OSError as error:  # no room for temporary files
            self._viewer.fail(error)
            return
        self.run(trials, settings, show)

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

    # Trial encodings

    @property
    def scenes(self) -> Sequence[Trial | Opened]:
        """The source, and then the trials; empty if nothing was encoded."""
        return [] if self.trials is None else [self.trials.source, *self.trials.all]

    def letters(self, number: int) -> str:
        """Panes that show one of `scenes`: A, B, both, or none."""
        shown = [self._opened.get(scene) for scene in self._viewer.stage.scenes]
        return "".join(letter for letter, k in zip("AB", shown, strict=False) if k == number)

    def is_trial(self, scene: Opened) -> bool:
        """Whether a scene is a trial of a frame of a sequence."""
        source = self.trials and self.trials.source.moment
        return source is not None and scene.moment is None and scene in self._opened

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

        viewer.load(f"decoding {chosen.name}", job, put)

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

        def job(stale: Stale) -> None:
            trials.save(tried, Path(path))

        viewer.worker.submit(f"save {path}", job, done, viewer.fail)

    def close(self) -> None:
        """Remove the temporary files."""
        if self._files is not None:
            self._files.cleanup()
