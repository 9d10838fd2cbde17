"""The path tab: keyframes, flights, films and files of the camera path."""

from __future__ import annotations

from open3d.visualization import gui

from viewer.window.controls import Controls
from viewer.window.widgets import Widgets

#: Name of the path among the contents of the dock.
_DOCK = "camera path"


class PathTab:
    """Buttons for keyframes, flight, films and files, and the path's duration."""

    def __init__(self, viewer: Controls, widgets: Widgets) -> None:
        self._viewer = viewer
        timeline = viewer.timeline
        self.widget = parent = widgets.column()
        self._said = gui.Label("")
        parent.add_child(self._said)
        rows = (
            (
                ("Keep", timeline.keep, "Add this view to the path (I)."),
                ("Set", timeline.replace, "Replace the chosen keyframe by this view."),
                ("Drop", timeline.drop, "Remove the chosen keyframe, or the last."),
                ("Fly", timeline.fly, "Fly along the path, or stop (space)."),
                ("Even", timeline.even, "Fly at an even speed, in the same time."),
            ),
            (
                ("Film", timeline.ask_film, "Write an .mp4 film of the path; again: stop."),
                ("Save", timeline.ask_write, "Save the path, for films and nerfstudio."),
                ("Open", timeline.ask_open, "Open a path of nerfstudio or SuperSplat, or cameras."),
                ("Timeline", self._show, "Show the keyframes below the panes, or hide them."),
            ),
        )
        self.buttons: dict[str, gui.Button] = {}
        for row in rows:
            made = {text: widgets.button(text, action, tip) for text, action, tip in row}
            widgets.row(parent, *made.values())
            self.buttons |= made
        self.seconds = widgets.number(timeline.set_seconds)
        self.fps = widgets.number(timeline.set_fps, whole=True)
        widgets.row(parent, gui.Label("seconds"), self.seconds, gui.Label("fps"), self.fps)

    def _show(self) -> None:
        self._viewer.set_dock("nothing" if self._viewer.choice.dock == _DOCK else _DOCK)

    def refresh(self) -> None:
        """Update the controls from the viewer."""
        timeline = self._viewer.timeline
        path, open_ = timeline.path, bool(self._viewer.visits.viewpoints)
        self._said.text = timeline.text
        least = {"Set": 1, "Drop": 1, "Fly": 2, "Even": 3, "Film": 2, "Save": 2}
        for text, button in self.buttons.items():
            button.enabled = open_ and len(path.poses) >= least.get(text, 0)
        self.buttons["Set"].enabled &= timeline.chosen is not None
        if self.seconds.double_value != path.seconds:
            self.seconds.double_value = path.seconds
        self.fps.int_value = path.fps
