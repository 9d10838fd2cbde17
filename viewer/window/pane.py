"""A pane of the window: a scene drawn by Open3D, in front of a picture of its splats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from open3d.visualization import gui, rendering

from gs_codec.cameras.camera import Camera
from gs_codec.coding.far import find_far
from viewer.pictures.cubes import Cubes
from viewer.pictures.layers import EDGES, Points, block_colour, box_lines
from viewer.pictures.marker import LINES
from viewer.pictures.picture import (
    CELL_SIZE,
    LINE_COLOUR,
    POINT_SIZE,
    PRUNED_SIZE,
    SELECTED_SIZE,
)
from viewer.scenes.appearance import Look, which_drawn
from viewer.scenes.choice import Appearance
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose, of_camera
from viewer.window.backdrop import Backdrop
from viewer.window.lines import line_mesh

#: Near plane, relative to the farthest depth of the scene.
_NEAR = 1e-4

#: Far plane, relative to the same depth.
_BEYOND = 1.1

#: Size of a hidden picture, pixels. Pictures are shrunk instead of removed, because Open3D would
#: still draw removed ones.
HIDDEN = 1, 1

#: Depth of the frame's outline, relative to the near plane.
_OUTLINED = 1.5

#: Depths of dark and light lines, relative to the near plane.
_LINED = (1.4, 1.3)

#: Inset of the outline's centre line in the frame: half its width, pixels.
_IN = 0.75

#: Point sizes by name; `POINT_SIZE` for others.
_SIZES = {"pruned": PRUNED_SIZE, "octree": CELL_SIZE, "selected": SELECTED_SIZE}

#: Number of different values of a colour channel in the octree's edges: within 2 levels of 255.
_SHADES = 85

#: Number of frames after removing splats until the pane is resized for an instant; otherwise Open3D
#: would keep showing only the splats.
_STUCK = 4

#: Size of drawn cameras, relative to their median distance from their middle.
_FRUSTUM = 0.05

#: RGB of drawn cameras.
_FRUSTUM_COLOUR = (1.0, 0.6, 0.0)

#: Maximum tiles per splat in Open3D's splat shader; large enough for all tiles.
_MOST_TILES = 1 << 16

#: Maximum SH degree of Open3D's splat shader.
_MAX_DEGREE = 2


#: Geometries that Open3D can draw.
Geometry = o3d.geometry.Geometry3D | o3d.t.geometry.Geometry


class Pane:
    """A `SceneWidget` and its contents.

    Parameters
    ----------
    window : gui.Window

    Attributes
    ----------
    scene : Opened
        The scene shown; unset until the first.
    points : dict
        Points that can be shown, by name.
    """

    def __init__(self, window: gui.Window) -> None:
        self.widget = gui.SceneWidget()
        self.widget.scene = rendering.Open3DScene(window.renderer)
        self.widget.scene.show_skybox(False)
        view = self.widget.scene.view
        # Off: keeps colours unchanged, and halves the time of a frame.
        view.set_post_processing(False)
        view.set_antialiasing(False)
        self._backdrop = Backdrop(window, self.widget)
        self._picture: NDArray[np.float32] | None = None
        self._background = Appearance().background
        self._splats: Look | None = None
        self._stuck = 0
        self._shades: list[str] = []
        self._show_background()

    def put(self, scene: Opened) -> None:
        """Show another scene, initially with no layers."""
        self.show_splats(None)
        self.widget.scene.clear_geometry()
        self.scene = scene
        self.points: dict[str, Points] = {}
        self._outlined: tuple | None = None
        low, high = _box(scene.positions, scene.lengths)
        self._box = o3d.geometry.AxisAlignedBoundingBox(low, high)
        self._corners = np.asarray(self._box.get_box_points())

    def look(self, pose: Pose, width: int, height: int, left: int = 0) -> None:
        """Look from a pose; the pane shows the part of a picture that starts at column `left`."""
        frame = self.widget.frame
        if frame.width < 1 or frame.height < 1:
            return
        intrinsics = pose.intrinsics(width, height, left)
        self.widget.setup_camera(intrinsics, pose.extrinsics, frame.width, frame.height, self._box)
        depth = (pose.rotation @ (self._corners - pose.position).T)[2]
        far = _BEYOND * max(float(depth.max(initial=0.0)), 1e-3)
        camera = self.widget.scene.camera
        camera.set_projection(intrinsics, _NEAR * far, far, frame.width, frame.height)

    def outline(self, pose: Pose, width: int, height: int) -> None:
        """Draw a line around the camera's frame, in front of everything; sizes as in `look`."""
        framed, lens = pose.framed(width, height), pose.lens(width, height)
        if self._outlined != (framed, lens):
            self._outlined = framed, lens
            left, top, right, bottom = framed
            inside = (left, top), (right, top), (right, bottom), (left, bottom)
            corners = np.add(inside, [(_IN, _IN), (-_IN, _IN), (-_IN, -_IN), (_IN, -_IN)])
            self._replace("outline", (line_mesh([corners], 2 * _IN, lens), _solid(LINE_COLOUR)))
        self._bring_near("outline", pose, _OUTLINED)

    def show_lines(
        self,
        name: str,
        lines: list[NDArray],
        pose: Pose,
        width: int,
        height: int,
        light: tuple[float, float, float] | None = None,
    ) -> None:
        """Draw closed lines ``(n, 2)``, light on dark, in front of everything, or remove them.

        Lines are in pixels of a picture; its size is as in `look`. `light` is their RGB.
        """
        for depth, (thickness, colour) in zip(_LINED, LINES, strict=True):
            each = f"{name} at {depth}"
            self._replace(each, None)
            if lines:
                mesh = line_mesh(lines, thickness, pose.lens(width, height))
                self._replace(each, (mesh, _solid(light if light and any(colour) else colour)))
                self._bring_near(each, pose, depth)

    def _bring_near(self, name: str, pose: Pose, depth: float) -> None:
        """Place a geometry, given in the camera's axes, at a depth relative to the near plane."""
        near = self.widget.scene.camera.get_near()
        nearby = np.diag([depth * near] * 3 + [1.0])
        transform = np.linalg.inv(pose.extrinsics) @ nearby
        self.widget.scene.set_geometry_transform(name, transform)

    def set_background(self, colour: tuple[float, float, float]) -> None:
        """Set the background colour, RGB 0-1."""
        if colour != self._background:
            self._background = colour
            self._show_background()

    def show_picture(self, picture: NDArray[np.float32] | None) -> None:
        """Show a picture of the pane's size as the background, or remove it."""
        if self.widget.scene.has_geometry("draft"):
            self._replace("draft", None)
        if picture is None and self._picture is None:
            return
        self._picture = picture
        self._show_background()

    def _show_background(self) -> None:
        picture = self._picture
        if picture is None:
            # Open3D interprets a colour as sRGB, but shows pictures unchanged.
            picture = np.full((1, 1, 3), self._background, np.float32)
        self._backdrop.show(picture)

    def show_points(self, name: str, points: Points | None) -> None:
        """Show points under a name, replacing those with the same name."""
        if points is None or not len(points.positions):
            self._replace(name, None)
            return
        cloud, material = point_geometry(points)
        material.point_size = _SIZES.get(name, POINT_SIZE)
        self._replace(name, (cloud, material))

    def show_cells(self, cells: Cubes | Points | None) -> None:
        """Show or hide cells of the octree."""
        for name in self._shades:
            self._replace(name, None)
        self._shades = []
        if isinstance(cells, Cubes) and not cells.filled:
            self._show_edges(cells)
        elif isinstance(cells, Cubes):
            self._replace("octree", cube_geometry(cells))
        else:
            self.show_points("octree", cells)

    def _show_edges(self, cells: Cubes) -> None:
        """Show edges of cells, in shades of one colour each.

        Lines of any colour and width take a software driver a hundred times as long.
        """
        self._replace("octree", None)
        shades, numbers = np.unique(
            np.rint(_SHADES * cells.colours).astype(int), axis=0, return_inverse=True
        )
        for k, shade in enumerate(shades / _SHADES):
            lines, _ = box_geometry(cells.boxes[numbers.ravel() == k], shade[None])
            self._shades.append(f"octree {k}")
            self._replace(self._shades[-1], (lines, _solid(tuple(shade))))

    def show_boxes(self, boxes: NDArray | None) -> None:
        """Show the edges of boxes ``(n, 2, 3)``."""
        if boxes is None or not len(boxes):
            self._replace("boxes", None)
            return
        colours = np.array([block_colour(k) for k in range(len(boxes))])
        self._replace("boxes", box_geometry(boxes, colours))

    def show_splats(self, look: Look | None) -> None:
        """Draw the splats with Open3D's shader, or stop drawing them."""
        known, self._splats = self._splats, look
        drawn = self.widget.scene.has_geometry("splats")
        if look is None:
            self._replace("splats", None)
        elif known is None or not known.is_same(look):
            cloud = splat_cloud(self.scene, look)
            material = splat_material(self.scene, look.appearance)
            self._replace("splats", (cloud, material) if len(cloud.point.positions) else None)
        if drawn and not self.widget.scene.has_geometry("splats"):
            self._stuck = _STUCK

    def tick(self) -> bool:
        """Clear removed splats from the screen; return whether to draw the window."""
        if not self._stuck:
            return False
        self._stuck -= 1
        if not self._stuck:
            frame = self.widget.frame
            self.widget.frame = gui.Rect(frame.x, frame.y, frame.width, frame.height + 1)
            self.widget.frame = frame
        return True

    def _replace(
        self,
        name: str,
        drawn: tuple[Geometry, rendering.MaterialRecord] | None,
    ) -> None:
        scene = self.widget.scene
        if scene.has_geometry(name):
            scene.remove_geometry(name)
        if drawn is not None:
            geometry, material = drawn
            scene.add_geometry(name, geometry, material)


def point_geometry(
    points: Points,
) -> tuple[o3d.t.geometry.PointCloud, rendering.MaterialRecord]:
    """A cloud of points, and a material that shows their colours unchanged."""
    cloud = o3d.t.geometry.PointCloud(_tensor(points.positions))
    cloud.point["colors"] = _tensor(points.colours)
    material = rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    return cloud, material


def cube_geometry(
    cubes: Cubes,
) -> tuple[o3d.t.geometry.TriangleMesh, rendering.MaterialRecord]:
    """A mesh of cubes, and a material that shows their colours unchanged."""
    corners, colours = cubes.faces()
    mesh = o3d.t.geometry.TriangleMesh()
    mesh.vertex.positions = _tensor(corners.reshape(-1, 3))
    mesh.vertex.colors = _tensor(colours.reshape(-1, 3).repeat(4, axis=0))
    first = 4 * np.arange(corners[..., 0, 0].size, dtype=np.int32)[:, None]
    triangles = (first + np.array([0, 1, 2, 0, 2, 3], np.int32)).reshape(-1, 3)
    mesh.triangle.indices = o3d.core.Tensor.from_numpy(triangles)
    material = rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    return mesh, material


def box_geometry(
    boxes: NDArray, colours: NDArray
) -> tuple[o3d.geometry.LineSet, rendering.MaterialRecord]:
    """The edges of boxes ``(n, 2, 3)`` in colours ``(n, 3)`` or one, and a material for them."""
    corners, edges = box_lines(boxes)
    lines = o3d.geometry.LineSet(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector2iVector(edges)
    )
    each = np.broadcast_to(colours, (len(boxes), 3)).repeat(EDGES, axis=0)
    lines.colors = o3d.utility.Vector3dVector(each.astype(np.float64))
    material = rendering.MaterialRecord()
    material.shader = "unlitLine"
    material.line_width = 1.5
    return lines, material


def _solid(colour: tuple[float, float, float]) -> rendering.MaterialRecord:
    """A material of one displayed RGB colour.

    It has no texture: with one, Mesa's software driver takes seconds or minutes for thin triangles.
    """
    material = rendering.MaterialRecord()
    material.shader = "unlitSolidColor"
    # Open3D interprets this colour as sRGB, but output without post-processing stays linear.
    linear = np.asarray(colour)
    curved = 1.055 * linear ** (1 / 2.4) - 0.055
    material.base_color = (*np.where(linear < 0.0031308, 12.92 * linear, curved), 1.0)
    return material


def camera_lines(cameras: Sequence[Camera]) -> o3d.geometry.LineSet:
    """The frames of cameras, each with lines from its position."""
    places = np.array([camera.position for camera in cameras])
    reach = float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    lines = o3d.geometry.LineSet()
    for camera in cameras:
        pose, size = of_camera(camera), (camera.width, camera.height)
        lens = pose.intrinsics(*size)
        lines += o3d.geometry.LineSet.create_camera_visualization(
            *size, lens, pose.extrinsics, _FRUSTUM * (reach or 1.0)
        )
    lines.paint_uniform_color(_FRUSTUM_COLOUR)
    return lines


def draws_splats(device: str) -> bool:
    """Whether Open3D draws splats on a device; its shader is new, and slow without a GPU."""
    return device == "gpu" and hasattr(rendering.MaterialRecord, "gaussian_splat_sh_degree")


def splat_cloud(scene: Opened, look: Look) -> o3d.t.geometry.PointCloud:
    """The cloud of the drawn Gaussians for Open3D's splat shader, which needs unit quaternions."""
    mask = which_drawn(scene, look)
    if mask is None:
        cloud = scene.cloud.clone()
    else:
        cloud = scene.cloud.select_by_mask(o3d.core.Tensor.from_numpy(mask))
    rot = cloud.point["rot"].numpy()
    length = np.linalg.norm(rot, axis=1, keepdims=True)
    cloud.point["rot"] = _tensor(rot / np.where(length > 0, length, 1))
    if look.appearance.scale != 1:
        cloud.point["scale"] = cloud.point["scale"] * look.appearance.scale
    return cloud


def splat_material(scene: Opened, appearance: Appearance) -> rendering.MaterialRecord:
    """The material of Open3D's splat shader."""
    material = rendering.MaterialRecord()
    material.shader = "gaussianSplat"
    degree = min(scene.sh_degree, appearance.sh_degree, _MAX_DEGREE)
    material.gaussian_splat_sh_degree = degree
    # Otherwise larger splats would be skipped.
    material.gaussian_splat_max_tiles_per_splat = _MOST_TILES
    return material


def _tensor(array: NDArray) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array, np.float32))


def _box(positions: NDArray, lengths: NDArray) -> tuple[NDArray, NDArray]:
    """Lowest and highest coordinates of the finite centres, without far ones.

    With far centres, the near plane would be beyond all others.
    """
    kept = np.isfinite(positions).all(axis=1)
    finite = positions[kept]
    if not len(finite):
        return -np.ones(3), np.ones(3)
    with np.errstate(divide="ignore"):
        sizes = np.log(lengths[kept])
    if found := find_far(finite.T, sizes[None]):
        return found.near.low, found.near.high
    return finite.min(axis=0).astype(np.float64), finite.max(axis=0).astype(np.float64)
