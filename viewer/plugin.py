"""Open the viewer's window with one call, or add its actions to an Open3D visualizer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.image_files import find_image, seek_images
from gs_codec.cli.main import describe_error
from gs_codec.errors import printable
from gs_codec.formats.cloud import check_cloud
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.optional import check_installed
from gs_codec.runtime.wording import counted
from gs_codec.views.photographs import read_photograph
from viewer.pictures.centres import centres, pruned_centres
from viewer.pictures.layers import Legend, Points
from viewer.pictures.notes import draw_notes
from viewer.scenes.appearance import Look
from viewer.scenes.choice import Appearance, OctreeChoice
from viewer.scenes.opened import Opened, Pruned, open_scene, read_pruned
from viewer.scenes.pose import of_camera
from viewer.scenes.typed_paths import CAMERAS, FOLDERS, REPORTS, SCENES, Kind, first_folder
from viewer.scenes.view_request import Request, find_views, parse_layers
from viewer.scenes.viewpoints import find_viewpoints, nearest_camera
from viewer.window.display import find_device

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import Geometry, PointCloud
    from open3d.pybind.visualization import O3DVisualizer
    from open3d.visualization.rendering import MaterialRecord

#: Group name of the geometries that actions show.
_GROUP = "gs_codec"


@checked
def draw(
    *scenes: PointCloud | str | Path,
    cameras: str | Path | Sequence[gs_codec.Camera | Mapping[str, object]] | None = None,
    gt_images: str | Path | None = None,
    view: int | None = None,
    pruned: str | Path | None = None,
    layers: Sequence[str] | None = None,
    colour: str = "colour",
    colour_scale: str | None = None,
    octree_depth: int = OctreeChoice.depth,
    octree_colour: str = OctreeChoice.colouring,
    mode: str = "side",
    up: str | None = None,
    watch: bool = False,
    width: int = 1280,
    height: int = 800,
) -> None:
    """Show one scene, or two versions of one, and return when the window is closed.

    Parameters
    ----------
    *scenes : open3d.t.geometry.PointCloud, or path
        One or two clouds with the attributes from `gs_codec.read`, or paths of files to read.
    cameras : path, "auto", or sequence, optional
        Cameras to look from, as in `gs_codec.render`.
    gt_images : path, optional
        Folder of the cameras' photographs, shown next to the scenes.
    view : int, optional
        Index of the first camera to look from.
    pruned : path, optional
        Folder of a report of ``gs-codec prepare`` for the first scene.
    layers : sequence of str, optional
        Any of ``splats``, ``centres``, ``pruned``, ``boxes``, ``error`` and ``octree``; default:
        ``splats``, and ``pruned`` if a report is given.
    colour : {"colour", "opacity", "scale", "error", "bits", "sh", "class", "block"}
        Quantity that colours the centres: SH-DC; opacity; longest axis; colour difference from the
        nearest centre of the other scene; bits, class of step sizes or block (``.egs`` files only);
        or the sum of squares of SH-AC.
    colour_scale : {"linear", "log"}, optional
        Colour scale; default: linear for ``opacity`` and ``bits``, logarithmic for ``scale``,
        ``error`` and ``sh``.
    octree_depth : int
        Depth of the octree's cells, 1-12.
    octree_colour : {"occupancy", "bits"}
        Quantity that colours the cells: number of Gaussians, or their mean bits (``.egs`` files
        only).
    mode : {"side", "wipe", "flip"}
        Two scenes side by side, or in one view: divided by a line, or switched by a key.
    up : {"-y", "y", "-z", "z", "-x", "x"}, optional
        Up axis; default: from the cameras, given or estimated.
    watch : bool
        Whether to reload files that change.
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
        raise gs_codec.GsCodecError(f"draw: {counted(len(scenes), 'scene')}, expected one or two")
    for scene in scenes:
        if not isinstance(scene, str | Path):
            check_cloud(scene)
    a, b = (*scenes, None)[:2]
    folder = Path(pruned) if pruned is not None else None
    shown = tuple(layers) if layers is not None else parse_layers(None, folder)
    octree, size = OctreeChoice(int(octree_depth), octree_colour), (int(width), int(height))
    photographs = Path(gt_images) if gt_images is not None else None
    request = Request(
        a, b, cameras, photographs, folder, shown, colour, mode, view, size,
        octree=octree, up=up, scale=colour_scale, watch=watch,
    )  # fmt: skip
    request.check()
    check_installed("open3d", "draw")
    device = find_device()
    from viewer.window.main_window import run

    run(request, device)


def attach(visualizer: O3DVisualizer) -> Actions:
    """Add actions to the menu of an `open3d.visualization.O3DVisualizer`.

    The actions open a scene of any format that `gs_codec` reads, show the Gaussians that a report
    lists as pruned, colour centres by their error against another version, and show cameras and the
    photograph nearest to the view. Each action asks for a file.

    If a graphics card draws the window, Open3D's shader draws splats; otherwise centres are shown.
    Names of geometries contain the file and the layer. Legends and photographs appear in a small
    separate window, which closes with the visualizer; `attach` therefore calls `set_on_close` of
    the visualizer. If you set another function there, call `Actions.detach` in it. From the first
    action to `Actions.detach`, the visualizer's post-processing and antialiasing are off, so that
    colours match the legends; meanwhile lit materials, the background and the sky look darker.

    Parameters
    ----------
    visualizer : open3d.visualization.O3DVisualizer
        Visualizer whose menu gets the actions.

    Returns
    -------
    Actions
        The actions as methods that take paths; they raise `gs_codec.GsCodecError` if a file cannot
        be read.

    Examples
    --------
    With an `open3d.visualization.O3DVisualizer`:

    >>> actions = viewer.attach(visualizer)
    >>> actions.open("scene.ply")
    >>> actions.compare("scene.egs")
    >>> actions.detach()
    """
    import open3d

    if not isinstance(visualizer, open3d.visualization.O3DVisualizer):
        given = type(visualizer).__name__
        expected = "expected an open3d.visualization.O3DVisualizer"
        raise gs_codec.GsCodecError(f"visualizer: {given}, {expected}")
    actions = Actions(visualizer)
    for title, ask in (
        ("Open a scene ...", actions.ask_open),
        ("Show pruned Gaussians ...", actions.ask_pruned),
        ("Compare with another version ...", actions.ask_compare),
        ("Open cameras and photographs ...", actions.ask_photographs),
        ("Go to the nearest camera", actions.ask_nearest),
    ):
        visualizer.add_action(title, lambda _, ask=ask: ask())
    return actions


class Actions:
    """The actions that `attach` adds to a visualizer.

    Attributes
    ----------
    scene : Opened or None
        The last scene opened.
    cameras : list of gs_codec's Camera
        The last cameras opened.

    Examples
    --------
    With an `open3d.visualization.O3DVisualizer`:

    >>> actions = viewer.attach(visualizer)
    >>> actions.open("scene.ply")
    >>> actions.scene.count, actions.cameras
    (2000, [])
    >>> actions.detach()
    """

    def __init__(self, visualizer: O3DVisualizer) -> None:
        from viewer.window.notes_window import NotesWindow

        self._visualizer, self._attached = visualizer, True
        self._notes = NotesWindow()
        self._shown: list[str] = []
        self._frustums = ""
        self._images = Path()
        self.scene: Opened | None = None
        self.cameras: list[gs_codec.Camera] = []
        visualizer.set_on_close(self._closing)

    @checked
    def open(self, path: str | Path, up: str | None = None) -> None:
        """Show a scene from its overview, replacing the previous one; `up` as in `draw`."""
        request = Request(up=up)
        request.check()
        scene = open_scene(path)
        views = find_views(request, scene)
        points = centres(scene, "colour", [scene])
        self._show(scene, {"centres": points}, splats=True)
        self.scene = scene
        pose = find_viewpoints(scene, views, up or views.ups[0])[0].pose
        _, down, forward = pose.rotation
        middle = np.median(scene.positions, axis=0) if scene.count else pose.position + forward
        centre = pose.position + forward * np.linalg.norm(middle - pose.position)
        angle = float(np.degrees(2 * np.arctan(0.5 / pose.focal[1])))
        self._visualizer.setup_camera(angle, centre, pose.position, -down)

    @checked
    def pruned(self, folder: str | Path) -> None:
        """Show the Gaussians that preparation removed, coloured by reason, and the others."""
        scene = self._needed()
        pruned = read_pruned(folder, scene)
        left = pruned.labels == 0
        kept = Points(scene.positions[left], scene.colours[left])
        self._show(scene, {"kept": kept, "pruned": pruned_centres(scene, pruned)})
        self._note(f"{scene.name}: pruned", pruned=pruned)

    @checked
    def compare(self, path: str | Path) -> None:
        """Show only another version, its centres coloured by their error against the scene."""
        scene, other = self._needed(), open_scene(path)
        points = centres(other, "error", [scene, other])
        self._show(other, {f"error against {scene.name}": points})
        legends = [points.legend] if points.legend is not None else []
        self._note(f"{other.name} against {scene.name}", legends=legends)

    @checked
    def photographs(self, cameras: str | Path, images: str | Path) -> None:
        """Show the cameras of a file; `nearest` shows their images from a folder."""
        self._check()
        found = gs_codec.read_cameras(cameras)
        seek_images(images, found)
        self._visualizer.remove_geometry(self._frustums)
        self.cameras, self._images = found, Path(images)
        self._frustums = f"{printable(Path(cameras).name)}: cameras"
        self._process_colours(False)
        from viewer.window.pane import camera_lines

        self._visualizer.add_geometry(self._frustums, camera_lines(found), group=_GROUP)

    def nearest(self) -> str:
        """Look from the camera nearest to the view, show its photograph, and return its name."""
        self._check()
        if not self.cameras:
            raise gs_codec.GsCodecError("no cameras are open")
        model = self._visualizer.scene.camera.get_model_matrix()
        camera = nearest_camera(self.cameras, model[:3, 3], -model[:3, 2])
        pose, size = of_camera(camera), (camera.width, camera.height)
        self._visualizer.setup_camera(pose.intrinsics(*size), pose.extrinsics, *size)
        background = self._visualizer.scene.background_color[:3].tolist()
        _, image = read_photograph(camera, find_image(self._images, camera.name), background)
        self._note(f"photograph of {camera.name}", photograph=image)
        return camera.name

    def detach(self) -> None:
        """Remove all geometries. The menu items cannot be removed; they have no effect any more.

        Afterwards, all other methods raise `gs_codec.GsCodecError`.
        """
        self._clear()
        self._visualizer.remove_geometry(self._frustums)
        self._process_colours(True)
        self.scene, self.cameras, self._attached = None, [], False

    def ask_open(self) -> None:
        """Ask for a file and `open` it."""
        self._ask("Open a scene", SCENES, self.open)

    def ask_pruned(self) -> None:
        """Ask for a ``report.json``, and pass its folder to `pruned`."""
        self._ask("report.json of prepare", REPORTS, lambda path: self.pruned(Path(path).parent))

    def ask_compare(self) -> None:
        """Ask for a file and `compare` with it."""
        self._ask("Compare with", SCENES, self.compare)

    def ask_photographs(self) -> None:
        """Ask for a file of cameras and a folder of their images, for `photographs`."""
        self._ask(
            "Cameras",
            CAMERAS,
            lambda cameras: self._ask(
                "Folder of the photographs",
                FOLDERS,
                lambda images: self.photographs(cameras, images),
            ),
        )

    def ask_nearest(self) -> None:
        """Call `nearest`; show a message if it fails."""
        if self._attached:
            self._try(self.nearest)

    def _check(self) -> None:
        if not self._attached:
            raise gs_codec.GsCodecError("detached from the visualizer")

    def _needed(self) -> Opened:
        self._check()
        if self.scene is None:
            raise gs_codec.GsCodecError("no scene is open")
        return self.scene

    def _show(self, scene: Opened, points: dict[str, Points], splats: bool = False) -> None:
        """Show only these points of a scene, by layer; or its splats, with the points hidden."""
        from viewer.window.pane import draws_splats, point_geometry, splat_cloud, splat_material

        self._check()
        self._clear()
        self._process_colours(False)
        splats = splats and scene.count > 0 and draws_splats(find_device())
        for layer, each in points.items():
            self._add(f"{scene.name}: {layer}", *point_geometry(each), not splats)
        if splats:
            self._add(
                f"{scene.name}: splats",
                splat_cloud(scene, Look()),
                splat_material(scene, Appearance()),
            )

    def _process_colours(self, on: bool) -> None:
        """Set whether Open3D post-processes colours and antialiases edges; its default is on."""
        view = self._visualizer.scene.view
        view.set_post_processing(on)
        view.set_antialiasing(on)

    def _add(
        self,
        name: str,
        geometry: Geometry,
        material: MaterialRecord,
        visible: bool = True,
    ) -> None:
        self._visualizer.add_geometry(name, geometry, material, _GROUP, 0.0, visible)
        self._shown.append(name)

    def _clear(self) -> None:
        """Remove geometries of scenes, and notes."""
        for name in self._shown:
            self._visualizer.remove_geometry(name)
        self._shown.clear()
        self._notes.close()

    def _note(
        self,
        caption: str,
        legends: Sequence[Legend] = (),
        pruned: Pruned | None = None,
        photograph: NDArray[np.float32] | None = None,
    ) -> None:
        frame = self._visualizer.os_frame
        picture = draw_notes(caption, legends, pruned, photograph, frame.height // 3)
        self._notes.show(picture, frame)

    def _closing(self) -> bool:
        self._notes.close()
        return True

    def _ask(self, title: str, kind: Kind, then: Callable[[str], object]) -> None:
        from open3d.visualization import gui

        from viewer.window.dialogs import Modal
        from viewer.window.file_dialog import FileDialog, FileQuestion

        if not self._attached:
            return
        # A dialog needs a theme, and O3DVisualizer does not expose its own.
        window = gui.Application.instance.create_window(title, 720, 480)
        modal = Modal(window)

        def close() -> None:
            # Deferred, because Open3D is iterating over its windows.
            gui.Application.instance.post_to_main_thread(window, window.close)

        def closing() -> bool:
            dialog.release()
            return True

        scene = self.scene.path if self.scene is not None else Path()
        dialog = FileDialog(
            modal,
            FileQuestion(title, kind, first_folder(scene)),
            lambda path: self._try(lambda: then(path)),
            close,
        )
        window.set_on_key(modal.key)
        window.set_on_tick_event(modal.tick)
        window.set_on_close(closing)

    def _try(self, action: Callable[[], object]) -> None:
        """Run an action; show a message if it fails."""
        try:
            action()
        except (gs_codec.GsCodecError, OSError, MemoryError) as error:
            self._visualizer.show_message_box("Not possible", describe_error(error))
