"""The interfaces of the window and panel for other parts of the window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.scenes.choice import Choice
from viewer.scenes.view_request import Request
from viewer.scenes.worker import Result, Stale, Worker
from viewer.window.dialogs import Modal
from viewer.window.file_dialog import Files
from viewer.window.stage import Stage


class Status(Protocol):
    """The panel, for parts that report to it."""

    @property
    def doing(self) -> str:
        """Current activity and its progress, as text; empty if idle."""

    def say(self, text: str, progress: float | None = None) -> None:
        """Show a status line; with `progress` (0-1), also a progress bar and a Stop button."""

    def show_progress(self, progress: float) -> None:
        """Set the progress bar, 0-1."""

    def show(self, name: str) -> None:
        """Bring a tab to the front, by its name."""

    def refresh(self) -> None:
        """Update all controls and numbers from the viewer."""


class Host(Protocol):
    """The window, for its parts.

    Attributes
    ----------
    loads : str
        What is being loaded; empty if nothing is.
    """

    request: Request
    choice: Choice
    window: gui.Window
    worker: Worker
    modal: Modal
    files: Files
    stage: Stage
    panel: Status
    loads: str

    def may_load(self) -> bool:
        """Whether loading may begin; a dialog says if something else is being loaded."""

    def load(
        self,
        text: str,
        job: Callable[[Stale], Result],
        done: Callable[[Result], None],
        failed: Callable[[Exception], None] | None = None,
    ) -> None:
        """Load something in the background if `may_load`; `failed` is by default `fail`."""

    def fail(self, error: Exception) -> None:
        """Show an error in a dialog; the scenes shown stay."""

    def forget(self) -> None:
        """Forget lengths measured in the scene shown before."""

    def follow(self, matrix: NDArray) -> None:
        """Move what was put on the first scene with it, by a matrix ``(4, 4)``."""

    def refresh(self) -> None:
        """Update panes, dock and panel to the choice."""

    def refresh_panel(self) -> None:
        """Update dock and panel; the panes are up to date."""
