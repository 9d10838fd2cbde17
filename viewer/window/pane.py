"""A pane of the window: one scene drawn by Open3D, over a picture of its splats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from open3d.visualization import gui, rendering

from viewer.pictures.cubes import Cubes
from viewer.pictures.layers import EDGES, Points, block_colour, box_lines
from viewer.pictures.picture import (
    BACKGROUND,
    CELL_SIZE,
    LINE_COLOUR,
    POINT_SIZE,
    PRUNED_SIZE,
    SELECTED_SIZE,
)
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.region import Pixel
from viewer.window.strokes import STROKES, stroke_mesh

_BACKGROUND = (*BACKGROUND, 1.0)

#: Near and far plane, relative to the farthest depth of the scene.
_NEAR, _BEYOND = 1e-4, 1.1

#: Size of a hidden picture, pixels. Pictures are made this small instead of being removed, because
#: Open3D would sometimes abort: after a skipped frame it keeps the draw call of a removed picture,
#: and uses it again, without its texture, when another picture changes its size.
HIDDEN = 1, 1

#: Depth of the frame's outline, relative to the near plane; its width, pixels.
_BEFORE, _OUTLINE = 1.5, 1.5

#: Sizes of points by their name; of others `POINT_SIZE`.
_SIZES = {"pruned": PRUNED_SIZE, "octree": CELL_SIZE, "selected": SELECTED_SIZE}

#: Open3D's splat shader does not support SH degree 3.
_MAX_DEGREE = 2


class Pane:
    """A `SceneWidget` and its contents.

    Parameters
    ----------
    window : gui.Window
    scene : Opened

    Attributes
    ----------
    points : dict
        Points that may be shown, by name.
    """

    def __init__(self, window: gui.Window, scene: Opened) -> None:
        self.scene = scene
        self.points: dict[str, Points] = {}
        self.widget = gui.SceneWidget()
        self.widget.scene = rendering.Open3DScene(window.renderer)
        self.widget.scene.set_background(_BACKGROUND)
        self.widget.scene.show_skybox(False)
        view = self.widget.scene.view
        # Off: colours stay unchanged, and frames take half the time.
        view.set_post_processing(False)
        view.set_antialiasing(False)
        self._outlined: list | None = None
        low, high = _box(scene.positions)
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
        self.widget.force_redraw()

    def outline(self, pose: Pose, width: int, height: int) -> None:
        """Draw a line around the camera's frame, in front of everything; sizes as for `look`."""
        fx, fy, cx, cy = pose.lens(width, height)
        left, top, right, bottom = pose.framed(width, height)
        corners = [
            ((x - cx) / fx, (y - cy) / fy, 1.0)
            for inset in (0, _OUTLINE)
            for x in (left + inset, right - inset)
            for y in (top + inset, bottom - inset)
        ]
        if self._outlined != corners:
            self._outlined = corners
            self._replace("outline", *_ring(corners))
        near = self.widget.scene.camera.get_near()
        nearby = np.diag([_BEFORE * near] * 3 + [1.0])
        transform = np.linalg.inv(pose.extrinsics) @ nearby
        self.widget.scene.set_geometry_transform("outline", transform)

    def show_stroke(self, corners: Sequence[Pixel], pose: Pose, width: int, height: int) -> None:
        """Draw a closed line in front of everything; with fewer than two corners, remove it.

        Corners are pixels of the picture, whose size is as for `look`.
        """
        near, lens = self.widget.scene.camera.get_near(), pose.lens(width, height)
        for name, (wide, grey, depth) in STROKES.items():
            if len(corners) < 2:
                self._replace(name, None, None)
                continue
            self._replace(name, stroke_mesh(corners, wide, lens), _solid((grey, grey, grey)))
            nearby = np.diag([depth * near] * 3 + [1.0])
            transform = np.linalg.inv(pose.extrinsics) @ nearby
            self.widget.scene.set_geometry_transform(name, transform)

    def show_picture(self, picture: NDArray[np.float32] | None) -> None:
        """Show a picture of the pane's size behind everything, or remove it."""
        self._replace("draft", None, None)
        if picture is None:
            self.widget.scene.set_background(_BACKGROUND)
        else:
            self.widget.scene.set_background(_BACKGROUND, picture_of(picture))
        self.widget.force_redraw()

    def show_points(self, name: str, points: Points | None) -> None:
        """Show points under a name, replacing those with the same name."""
        if points is None or not len(points.positions):
            self._replace(name, None, None)
            return
        cloud, material = point_geometry(points)
        material.point_size = _SIZES.get(name, POINT_SIZE)
        self._replace(name, cloud, material)

    def show_cells(self, cells: Cubes | Points | None) -> None:
        """Show cells of the octree, or hide them."""
        if isinstance(cells, Cubes):
            self._replace("octree", *cube_geometry(cells))
        else:
            self.show_points("octree", cells)

    def show_boxes(self, boxes: NDArray | None) -> None:
        """Show the edges of boxes ``(n, 2, 3)``."""
        if boxes is None or not len(boxes):
            self._replace("boxes", None, None)
            return
        corners, edges = box_lines(boxes)
        colours = np.array([block_colour(k) for k in range(len(boxes))]).repeat(EDGES, axis=0)
        lines = o3d.geometry.LineSet(
            o3d.utility.Vector3dVector(corners), o3d.utility.Vector2iVector(edges)
        )
        lines.colors = o3d.utility.Vector3dVector(colours)
        material = rendering.MaterialRecord()
        material.shader = "unlitLine"
        material.line_width = 1.5
        self._replace("boxes", lines, material)

    def show_splats(self, wanted: bool) -> None:
        """Draw the splats with Open3D's own shader, or stop doing so."""
        if not wanted:
            self._replace("splats", None, None)
        elif not self.widget.scene.has_geometry("splats"):
            self._replace("splats", splat_cloud(self.scene), splat_material(self.scene))

    def _replace(self, name: str, geometry: Any, material: Any) -> None:
        scene = self.widget.scene
        if scene.has_geometry(name):
            scene.remove_geometry(name)
        if geometry is not None:
            scene.add_geometry(name, geometry, material)
        self.widget.force_redraw()


def picture_of(image: NDArray) -> o3d.geometry.Image:
    """Open3D's image of an array ``(H, W, 3)``, float32 or uint8."""
    return o3d.geometry.Image(np.ascontiguousarray(image))  # type: ignore[call-overload]


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


def _ring(corners: list) -> tuple[o3d.geometry.TriangleMesh, rendering.MaterialRecord]:
    """The ring between four outer and four inner corners, visible from both sides, of one colour.

    Lines are not used, because Open3D does not draw horizontal ones. The shader has no texture,
    because Mesa's software driver would take seconds or minutes for such thin triangles.
    """
    around = [0, 2, 3, 1]
    sides = [(around[k], around[(k + 1) % 4]) for k in range(4)]
    triangles = [t for a, b in sides for t in ((a, b, a + 4), (b, b + 4, a + 4))]
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(corners)),
        o3d.utility.Vector3iVector(np.array(triangles + [t[::-1] for t in triangles], np.int32)),
    )
    return mesh, _solid(LINE_COLOUR)


def _solid(colour: tuple[float, float, float]) -> rendering.MaterialRecord:
    """A material of one colour, RGB as it is to be seen."""
    material = rendering.MaterialRecord()
    material.shader = "unlitSolidColor"
    # Open3D takes this colour as sRGB, but output without post-processing stays linear.
    material.base_color = (*np.power(colour, 1 / 2.2), 1.0)
    return material


def splat_cloud(scene: Opened) -> o3d.t.geometry.PointCloud:
    """The cloud for Open3D's splat shader, which needs unit quaternions."""
    cloud = scene.cloud.clone()
    rot = cloud.point["rot"].numpy()
    length = np.linalg.norm(rot, axis=1, keepdims=True)
    cloud.point["rot"] = _tensor(rot / np.where(length > 0, length, 1))
    return cloud


def splat_material(scene: Opened) -> rendering.MaterialRecord:
    """The material of Open3D's splat shader."""
    material = rendering.MaterialRecord()
    material.shader = "gaussianSplat"
    material.gaussian_splat_sh_degree = min(scene.sh_degree, _MAX_DEGREE)
    return material


def _tensor(array: NDArray) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array, np.float32))


def _box(positions: NDArray) -> tuple[NDArray, NDArray]:
    """Lowest and highest coordinates of the finite centres."""
    finite = positions[np.isfinite(positions).all(axis=1)]
    if not len(finite):
        return -np.ones(3), np.ones(3)
    return finite.min(axis=0).astype(np.float64), finite.max(axis=0).astype(np.float64)
