"""Encode and measure trials in the background, one job at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from gs_codec.metrics.comparison import Comparison
from viewer.scenes.opened import Opened, Progress
from viewer.scenes.trial_list import EncodingSettings, Trial, Trials
from viewer.scenes.worker import Cancelled, Stale, Worker

#: Minimum interval between progress updates, seconds, because showing them takes time too.
_PERIOD = 0.2


class TrialJobs:
    """Trial encodings, and the jobs that make and measure them.

    Parameters
    ----------
    worker : Worker
        Runs only these jobs, so that pictures need not wait.
    changed : callable
        Called when `doing` changes.
    fail : callable
        Called with the error of a job.

    Attributes
    ----------
    worker : Worker
    trials : Trials or None
        None until the first encoding.
    doing : tuple of str and float, or None
        Current step and its progress, 0-1; None if idle.
    encodes : bool
        Whether a scene is being encoded.
    """

    def __init__(
        self, worker: Worker, changed: Callable[[], None], fail: Callable[[Exception], None]
    ) -> None:
        self.worker, self._changed, self._fail = worker, changed, fail
        self.trials: Trials | None = None
        self.doing: tuple[str, float] | None = None
        self.encodes = False

    def run(
        self, trials: Trials, settings: EncodingSettings, show: Callable[[Trial, Opened], None]
    ) -> None:
        """Encode the source of `trials`, call `show` with the trial and its scene, and measure."""

        def job(stale: Stale) -> tuple[Trial, Opened]:
            return trials.encode(settings, self._progress(stale, "encoding"))

        def done(found: tuple[Trial, Opened]) -> None:
            tried, opened = found
            trials.add(tried)
            self.encodes = False
            show(tried, opened)
            self._measure(opened)

        def failed(error: Exception) -> None:
            self.encodes = False
            self._measure()
            self._fail(error)

        self.worker.cancel("measure")
        self.trials, self.encodes = trials, True
        self._do("encoding", 0.0)
        self.worker.submit("encode", job, done, failed)

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
            self._fail(error)

        self._do(f"measuring #{tried.number}", 0.0)
        self.worker.submit("measure", job, done, failed)

    def cancel(self) -> None:
        """Stop encoding or measuring; finished trials stay."""
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
