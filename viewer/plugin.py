"""Open the viewer's window by one call, or add its actions to any Open3D visualizer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gs_codec
from viewer.pictures.centres import centres, pruned_centres
from viewer.pictures.layers import Points
from viewer.scenes.choice import OctreeChoice
from viewer.scenes.opened import Opened, open_scene, read_pruned
from viewer.scenes.request import Request, parse_layers
from viewer.scenes.viewpoints import choose_views, find_viewpoints
from viewer.window.device import find_device


def draw(
    *scenes: Any,
    cameras: Any = None,
    pruned: str | Path | None = None,
    layers: Sequence[str] | None = None,
    colour: str = "colour",
    colour_scale: str | None = None,
    octree_depth: int = OctreeChoice.depth,
    octree_colour: str = OctreeChoice.colouring,
    mode: str = "side",
    width: int = 1280,
    height: int = 800,
) -> None:
    """Show one scene, or two versions of one, and return when the window is closed.

    Parameters
    ----------
    *scenes : open3d.t.geometry.PointCloud, or path
        One or two: clouds with the attributes that `gs_codec.read` gives, or files that it reads.
    cameras : path, "auto", or sequence, optional
        Cameras to look from, as for `gs_codec.render`.
    pruned : path, optional
        Folder of a report of ``gs-codec prepare`` for the first scene.
    layers : sequence of str, optional
        Of ``splats``, ``centres``, ``pruned``, ``boxes``, ``error`` and ``octree``; by default
        ``splats``, and ``pruned`` if a report is given.
    colour : {"colour", "opacity", "scale", "error", "bits", "sh", "class", "block"}
        Quantity that centres are coloured by: SH-DC; opacity; longest axis; difference in colour
        from the nearest centre of the other scene; of an ``.egs`` file the bits that it takes, its
        class of step sizes, or its block; the sum of the squares of its SH-AC.
    colour_scale : {"linear", "log"}, optional
        Scale of the colours of ``opacity`` and ``bits``, by default linear, or of ``scale``,
        ``error`` and ``sh``, by default logarithmic.
    octree_depth : int
        Depth of the octree's cells, 1-12.
    octree_colour : {"occupancy", "bits"}
        What these are coloured by: how many Gaussians they hold, or, of an ``.egs`` file, the
        mean of these Gaussians' bits.
    mode : {"side", "wipe", "flip"}
        Two scenes side by side, or in one view: divided by a line, or switched by a key.
    width, height : int
        Size of the window, 64-16384 pixels.

    Raises
    ------
    gs_codec.GsCodecError
        If a scene cannot be read, or no window can be opened.

    Examples
    --------
    >>> viewer.draw("scene.ply", "scene.egs", cameras="cameras.json", mode="wipe")
    """
    if not 1 <= len(scenes) <= 2:
        raise gs_codec.GsCodecError(f"draw: {len(scenes)} scenes, expected one or two")
    a, b = (*scenes, None)[:2]
    folder = Path(pruned) if pruned is not None else None
    shown = tuple(layers) if layers is not None else parse_layers(None, folder)
    octree, size = OctreeChoice(octree_depth, octree_colour), (width, height)
    request = Request(
        a, b, cameras, None, folder, shown, colour, mode, size=size, octree=octree,
        scale=colour_scale,
    )  # fmt: skip
    request.check()
    device = find_device()
    from viewer.window.viewer import run

    run(request, device)


def attach(visualizer: Any) -> Actions:
    """Add actions to the menu of an `open3d.visualization.O3DVisualizer`.

    The actions open an ``.egs`` (or ``.ply``) scene, show the Gaussians that a report lists as
    pruned, and colour centres by their error against another version. Each asks for a file.

    Parameters
    ----------
    visualizer : open3d.visualization.O3DVisualizer
        Its menu gets the actions.

    Returns
    -------
    Actions
        The same actions as methods that take a path; they raise `gs_codec.GsCodecError` if a file
        cannot be read.

    Examples
    --------
    With an `open3d.visualization.O3DVisualizer`:

    >>> actions = viewer.attach(visualizer)
    >>> actions.open("scene.ply")
    >>> actions.compare("scene.egs")
    >>> actions.detach()
    """
    actions = Actions(visualizer)
    for title, ask in (
        ("Open a compressed scene ...", actions.ask_open),
        ("Show what was pruned ...", actions.ask_pruned),
        ("Compare with another version ...", actions.ask_compare),
    ):
        visualizer.add_action(title, lambda _, ask=ask: ask())
    return actions


class Actions:
    """The actions that `attach` adds to a visualizer.

    Attributes
    ----------
    scene : Opened or None
        The scene opened last.
    """

    def __init__(self, visualizer: Any) -> None:
        self._visualizer = visualizer
        self._title, self._attached = visualizer.title, True
        self.scene: Opened | None = None

    def open(self, path: str | Path) -> None:
        """Show the centres of a scene, replacing the previous one."""
        scene = open_scene(path)
        self._show(centres=centres(scene, "colour", [scene]))
        self.scene = scene
        views = choose_views(scene, count=1)
        pose = find_viewpoints(scene, views, views.ups[0])[0].pose
        _, down, forward = pose.rotation
        middle = np.median(scene.positions, axis=0) if scene.count else pose.position + forward
        centre = pose.position + forward * np.linalg.norm(middle - pose.position)
        angle = float(np.degrees(2 * np.arctan(0.5 / pose.focal[1])))
        self._visualizer.setup_camera(angle, centre, pose.position, -down)

    def pruned(self, folder: str | Path) -> None:
        """Show the Gaussians that preparation removed, coloured by reason, and the others."""
        scene = self._needed()
        pruned = read_pruned(folder, scene)
        left = pruned.labels == 0
        kept = Points(scene.positions[left], scene.colours[left])
        self._show(centres=kept, pruned=pruned_centres(scene, pruned))

    def compare(self, path: str | Path) -> None:
        """Show only another version, coloured by its error against the scene.

        The window's title explains the colours.
        """
        scene, other = self._needed(), open_scene(path)
        self._show(centres=centres(other, "error", [scene, other]))

    def detach(self) -> None:
        """Remove what was shown; the menu items stay, without effect, as they cannot be removed.

        After this, the other methods raise `gs_codec.GsCodecError`.
        """
        self._show()
        self.scene, self._attached = None, False

    def ask_open(self) -> None:
        """Ask for a file and `open` it."""
        self._ask("Open a scene", self.open)

    def ask_pruned(self) -> None:
        """Ask for a ``report.json`` and show its folder's report by `pruned`."""
        self._ask("report.json of prepare", lambda path: self.pruned(Path(path).parent))

    def ask_compare(self) -> None:
        """Ask for a file and `compare` with it."""
        self._ask("Compare with", self.compare)

    def _needed(self) -> Opened:
        if self.scene is None:
            raise gs_codec.GsCodecError("no scene is open")
        return self.scene

    def _show(self, **points: Points) -> None:
        """Show only these points, by name; the window's title gets their legend."""
        from viewer.window.pane import point_geometry

        if not self._attached:
            raise gs_codec.GsCodecError("detached from the visualizer")
        for name in ("centres", "pruned"):
            self._visualizer.remove_geometry(f"gs_codec {name}")
        for name, each in points.items():
            self._visualizer.add_geometry(f"gs_codec {name}", *point_geometry(each))
        legends = [each.legend for each in points.values() if each.legend is not None]
        said = [
            f"{legend.title}: {legend.marks[0]} dark, {legend.marks[-1]} yellow"
            for legend in legends
        ]
        self._visualizer.title = " - ".join([self._title, *said])

    def _ask(self, title: str, then: Any) -> None:
        from open3d.visualization import gui

        if not self._attached:
            return
        # A file dialog needs a theme, and O3DVisualizer does not give access to its own.
        window = gui.Application.instance.create_window(title, 720, 480)
        dialog = gui.FileDialog(gui.FileDialog.OPEN, title, window.theme)
        dialog.set_on_cancel(window.close)

        def done(path: str) -> None:
            window.close()
            try:
                then(path)
            except (gs_codec.GsCodecError, OSError) as error:
                self._visualizer.show_message_box("Not possible", str(error))

        dialog.set_on_done(done)
        window.show_dialog(dialog)
