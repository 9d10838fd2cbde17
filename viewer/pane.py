"""A pane of the window: one scene, drawn by Open3D from a pose, over a picture of its splats."""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from open3d.visualization import gui, rendering

from viewer.layers import EDGES, Points, block_colour, box_lines
from viewer.opened import Opened
from viewer.picture import BACKGROUND, LINE_COLOUR, POINT_SIZE, PRUNED_SIZE
from viewer.pose import Pose

_BACKGROUND = (*BACKGROUND, 1.0)

#: Nearest and farthest that is drawn, by the distance of what is farthest.
_NEAR, _BEYOND = 1e-4, 1.1

#: Size of a picture that is not to be seen, pixels. Were it taken away instead, Open3D would abort
#: now and then: it keeps what drew a picture more in the last frame, if it skipped that one, and
#: draws with it again although the texture is gone as soon as another picture changes its size.
HIDDEN = 1, 1

#: Where the outline of the frame is, by the nearest distance that is drawn; its width, pixels.
_BEFORE, _OUTLINE = 1.5, 1.5

#: Open3D's splat shader has no third degree.
_MAX_DEGREE = 2


class Pane:
    """A `SceneWidget` and what is in it.

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
        # Colours as they are, and frames in half the time.
        view.set_post_processing(False)
        view.set_antialiasing(False)
        self._outlined: list | None = None
        low, high = _box(scene.positions)
        self._box = o3d.geometry.AxisAlignedBoundingBox(low, high)
        self._corners = np.asarray(self._box.get_box_points())

    def look(self, pose: Pose, width: int, height: int, left: int = 0) -> None:
        """Look from a pose; the pane is the part of a picture that begins `left` pixels in."""
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
        """Draw a line around the camera's frame, in front of all; arguments as for `look`."""
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
        place = np.linalg.inv(pose.extrinsics) @ nearby
        self.widget.scene.set_geometry_transform("outline", place)

    def show_picture(self, picture: NDArray[np.float32] | None) -> None:
        """Put a picture of the pane's size behind everything, or take it away."""
        self._replace("draft", None, None)
        if picture is None:
            self.widget.scene.set_background(_BACKGROUND)
        else:
            self.widget.scene.set_background(_BACKGROUND, picture_of(picture))
        self.widget.force_redraw()

    def show_points(self, name: str, points: Points | None) -> None:
        """Show points under a name, in place of those it had."""
        if points is None or not len(points.positions):
            self._replace(name, None, None)
            return
        cloud, material = point_geometry(points)
        material.point_size = PRUNED_SIZE if name == "pruned" else POINT_SIZE
        self._replace(name, cloud, material)

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
        """Draw the splats by Open3D's own shader."""
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
    """A cloud of points, and the material that shows their colours as they are."""
    cloud = o3d.t.geometry.PointCloud(_tensor(points.positions))
    cloud.point["colors"] = _tensor(points.colours)
    material = rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    return cloud, material


def _ring(corners: list) -> tuple[o3d.geometry.TriangleMesh, rendering.MaterialRecord]:
    """What is between four outer corners and four inner ones, of one colour from both sides.

    Lines would not do: Open3D draws none that is level. Nor would a shader that looks up a
    texture: with one, Mesa's software driver stays in these slivers for seconds or minutes.
    """
    around = [0, 2, 3, 1]
    sides = [(around[k], around[(k + 1) % 4]) for k in range(4)]
    triangles = [t for a, b in sides for t in ((a, b, a + 4), (b, b + 4, a + 4))]
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(corners)),
        o3d.utility.Vector3iVector(np.array(triangles + [t[::-1] for t in triangles], np.int32)),
    )
    material = rendering.MaterialRecord()
    material.shader = "unlitSolidColor"
    # Open3D takes this one for sRGB, and what is drawn without post-processing stays linear.
    material.base_color = (*np.power(LINE_COLOUR, 1 / 2.2), 1.0)
    return mesh, material


def splat_cloud(scene: Opened) -> o3d.t.geometry.PointCloud:
    """The cloud as Open3D's splat shader wants it: of unit quaternions."""
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
    """Lowest and highest of the finite coordinates."""
    finite = positions[np.isfinite(positions).all(axis=1)]
    if not len(finite):
        return -np.ones(3), np.ones(3)
    return finite.min(axis=0).astype(np.float64), finite.max(axis=0).astype(np.float64)
