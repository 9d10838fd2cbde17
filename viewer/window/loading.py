"""Load scenes, cameras, photographs and reports into the window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import gs_codec
from gs_codec.cli.main import describe_error
from viewer.scenes.opened import Opened, Pruned, read_pruned, turned
from viewer.scenes.recent import recent_files, remember
from viewer.scenes.saving import open_file
from viewer.scenes.typed_paths import CAMERAS, FOLDERS, REPORTS, SEQUENCES, Kind
from viewer.scenes.view_request import find_pruned, find_views, first_view
from viewer.scenes.viewpoints import Views
from viewer.scenes.worker import Stale
from viewer.window import dialogs
from viewer.window.editor import Editor
from viewer.window.shared import Host
from viewer.window.visits import Visits


class Loading:
    """Loads files in the background, then shows them.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    editor : Editor
    """

    def __init__(self, viewer: Host, visits: Visits, editor: Editor) -> None:
        self._viewer, self._visits, self._editor = viewer, visits, editor

    def begin(self) -> None:
        """Load everything requested on the command line."""
        viewer, request = self._viewer, self._viewer.request

        def read(stale: Stale) -> tuple[list[Opened], Views, Pruned | None]:
            scenes = request.scenes(viewer.worker.progress(stale, viewer.panel.show_progress))
            self._preview(stale, scenes)
            return scenes, self._first_views(stale, scenes), find_pruned(request, scenes[0])

        def done(found: tuple[list[Opened], Views, Pruned | None]) -> None:
            for source in (request.a, request.b):
                if isinstance(source, str | Path):
                    remember(Path(source))
            self.show(*found)

        viewer.load("loading", read, done, self._failed)

    def _preview(self, stale: Stale, scenes: list[Opened]) -> None:
        """Show centres from above until the first view is known; part of a job."""
        viewer = self._viewer

        def show(_: float) -> None:
            viewer.stage.put(scenes, None)
            self._editor.put(scenes)
            self._visits.put(Views(), 0)
            viewer.stage.painter.until = stale

        viewer.worker.progress(stale, show)("preview", 1, 1)

    def _failed(self, error: Exception) -> None:
        self._viewer.stage.painter.until = None
        self._viewer.fail(error)

    def _first_views(self, stale: Stale, scenes: list[Opened]) -> Views:
        """The first cameras; part of the job that loads scenes."""
        viewer = self._viewer
        if viewer.request.chosen:
            status = "choosing the first view ..."
            viewer.worker.progress(stale, partial(viewer.panel.say, status))("views", 1, 1)
        return find_views(viewer.request, scenes[0])

    def open(self, path: str, pane: int | None = None) -> None:
        """Open a file as the first scene, the second, or in place of scene `pane` (0 or 1).

        If two scenes are open and `pane` is None, a dialog asks which one to replace.
        """
        viewer = self._viewer
        if not viewer.may_load():
            return
        before = list(viewer.stage.scenes)
        if len(before) > 1 and pane is None:
            names = [scene.name for scene in before]
            dialogs.ask_pane(viewer.modal, Path(path).name, names, partial(self.open, path))
            return
        pane = len(before) if pane is None else min(pane, len(before))
        if self._editor.ask_unsaved([pane], partial(self.open, path, pane)):
            return
        views, chosen = self._visits.views, viewer.request.chosen

        def read(stale: Stale) -> tuple[Opened, Views]:
            progress = viewer.worker.progress(stale, viewer.panel.show_progress)
            opened = open_file(path, progress, viewer.request.max_bytes)
            if not before:
                self._preview(stale, [opened])
            return opened, self._first_views(stale, [opened]) if chosen and not pane else views

        def done(found: tuple[Opened, Views]) -> None:
            opened, seen = found
            remember(Path(path))
            scenes = [*viewer.stage.scenes[:pane], opened, *viewer.stage.scenes[pane + 1 :]]
            self.show(scenes, seen, viewer.stage.pruned if pane else None)

        viewer.load(f"loading {Path(path).name}", read, done, self._failed)

    def reload(self, pane: int, path: Path, then: Callable[[], None] = lambda: None) -> None:
        """Show a file in place of scene `pane`, of which it is a later version; the pose stays.

        Unsaved edits are lost. If the file cannot be read, the panel says so; otherwise `then` is
        called.
        """
        viewer, before = self._viewer, self._viewer.stage.scenes[pane]

        def read(stale: Stale) -> Opened:
            progress = viewer.worker.progress(stale, viewer.panel.show_progress)
            opened = open_file(path, progress, viewer.request.max_bytes)
            return turned(opened) if before.system_given else opened

        def done(opened: Opened) -> None:
            stage = viewer.stage
            if before not in stage.scenes:
                viewer.panel.say("not reloaded, because the scene was edited: ctrl + R reloads it")
                return
            viewer.panel.say(f"{path.name} reloaded")
            if pane == 0:
                stage.pruned = None
            self._editor.forget(pane)
            stage.replace(pane, opened)
            self._editor.put(stage.scenes)
            viewer.refresh()
            then()

        def failed(error: Exception) -> None:
            viewer.panel.say(f"not reloaded: {describe_error(error)}")

        viewer.load(f"loading {path.name}", read, done, failed)

    def reload_all(self) -> None:
        """Read changed files of the scenes again; asks first if unsaved edits would be lost."""
        if not self._viewer.may_load():
            return
        scenes = self._viewer.stage.scenes
        changed = [k for k, each in enumerate(scenes) if each.can_reload and each.has_changed]
        if changed and not self._editor.ask_unsaved(changed, self.reload_all):
            self.reload(changed[0], scenes[changed[0]].path, self.reload_all)

    def stop(self) -> None:
        """Stop loading or selecting; the scenes shown stay."""
        self._viewer.worker.cancel("load")
        self._viewer.loads = ""
        self._editor.stop()
        self._viewer.panel.say("")

    def show(
        self, scenes: list[Opened], views: Views, pruned: Pruned | None, stay: bool = False
    ) -> None:
        """Show opened scenes instead of the present ones; `stay` keeps the pose.

        Asks first if unsaved edits would be lost.
        """
        viewer = self._viewer
        viewer.panel.say("")
        stage = viewer.stage
        previewed, stage.painter.until = stage.painter.waits, None
        dropped = [k for k, edits in enumerate(self._editor.all) if edits.scene not in scenes]
        if self._editor.ask_unsaved(dropped, partial(self.show, scenes, views, pruned, stay)):
            return
        same = stay or (stage.scenes[:1] == scenes[:1] and not previewed)
        if previewed and stage.scenes == scenes:
            stage.put_pruned(pruned)
        else:
            stage.put(scenes, pruned)
        self._editor.put(scenes)
        if not same:  # otherwise keep the present pose
            viewer.forget()
            self._visits.put(views, first_view(viewer.request, views))
        viewer.refresh()

    def turn(self) -> None:
        """Convert B between ``RUB`` and ``RDF``; for files that do not state their system."""
        viewer = self._viewer
        if len(viewer.stage.scenes) < 2:
            return
        edits = self._editor.all[1]
        whole = edits.whole
        if edits.scene.moves or whole.sources:
            viewer.fail(gs_codec.GsCodecError("B was placed: turn it in the tab Place"))
            return

        def done(scene: Opened) -> None:
            edits.turn(scene)
            scenes = [viewer.stage.scenes[0], edits.scene]
            self.show(scenes, self._visits.views, viewer.stage.pruned)

        viewer.load(f"converting {whole.name}", lambda stale: turned(whole), done)

    def open_cameras(self, path: str) -> None:
        """Look from the cameras of a file, and remove photographs of others."""
        viewer = self._viewer
        scene = viewer.stage.scenes[0]
        request = replace(viewer.request, cameras=path, view=None, images=None)

        def done(views: Views) -> None:
            viewer.panel.say("")
            viewer.request = request
            self._visits.put(views, first_view(request, views))

        viewer.load(f"loading {Path(path).name}", lambda stale: find_views(request, scene), done)

    def open_photographs(self, folder: str) -> None:
        """Show the photographs in a folder next to the scenes, each with its camera."""
        viewer = self._viewer
        if viewer.request.chosen or not self._visits.views.cameras:
            viewer.fail(gs_codec.GsCodecError("photographs: need cameras from a file"))
            return
        viewer.request = replace(viewer.request, images=Path(folder))
        self._visits.go_to(max(self._visits.number, self._visits.views.first))

    def open_report(self, path: str) -> None:
        """Show the pruned Gaussians of the first scene, from a report's file or folder."""
        viewer = self._viewer
        scene = viewer.stage.scenes[0]
        folder = Path(path) if Path(path).is_dir() else Path(path).parent

        def done(pruned: Pruned) -> None:
            viewer.choice.layers.add("pruned")
            self.show(list(viewer.stage.scenes), self._visits.views, pruned)

        viewer.load(f"loading {folder.name}", lambda stale: read_pruned(folder, scene), done)

    def ask_open(self, pane: int | None = None) -> None:
        """Ask for a scene or a sequence, and call `open`."""
        title = "Open a scene" if pane is None else f"Open {'AB'[pane]}"
        self._viewer.files.ask_open(title, SEQUENCES, partial(self.open, pane=pane))

    def ask_recent(self) -> None:
        """Ask which of the recently opened files to open."""
        dialogs.ask_recent(self._viewer.modal, recent_files(), self.open)

    def ask_cameras(self) -> None:
        """Ask for a file of cameras, and look from them."""
        self._ask("Open cameras", CAMERAS, self.open_cameras)

    def ask_photographs(self) -> None:
        """Ask for the folder of photographs, and show them."""
        self._ask("Folder of the photographs", FOLDERS, self.open_photographs)

    def ask_report(self) -> None:
        """Ask for a pruning report of the first scene, and show it."""
        self._ask("Report of the Gaussians pruned from A", REPORTS, self.open_report)

    def _ask(self, title: str, kind: Kind, then: Callable[[str], None]) -> None:
        if not self._viewer.stage.scenes:
            self._viewer.fail(gs_codec.GsCodecError(f"{title.lower()}: open a scene first"))
            return
        self._viewer.files.ask_open(title, kind, then)
