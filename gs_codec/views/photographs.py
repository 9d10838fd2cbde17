"""Read photographs, and fit cameras to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import read_image
from gs_codec.cameras.lens import Lens
from gs_codec.errors import InvalidInput
from gs_codec.runtime.optional import needed


def read_photograph(
    camera: Camera, path: Path, background: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[Camera, NDArray[np.float32]]:
    """Read a camera's photograph, undistorted, and resize the camera to it.

    The photograph of a camera with a lens may be smaller than the lens states. It counts as already
    undistorted if its size is that of the `Lens.pinhole` camera, or that divided by a whole number,
    and is not such a size of the lens. Raises InvalidInput if the photograph is damaged, or its
    shape differs from the camera's. Raises MissingTool if it must be undistorted, and OpenCV is not
    installed.

    Parameters
    ----------
    camera : Camera
    path : Path
    background : sequence of three float
        RGB behind its transparent parts.

    Returns
    -------
    Camera
        The camera, with the size of the image.
    ndarray, shape (H, W, 3), float32
        0-1.
    """
    image = read_image(path, background)
    size = image.shape[1], image.shape[0]
    lens = camera.lens
    if lens is None:
        _check_shape(path, size, (camera.width, camera.height))
        return camera.resized(*size), image
    pinhole = lens.pinhole()
    whole = pinhole["width"], pinhole["height"]
    if _divides(size, whole) and not _divides(size, (lens.width, lens.height)):
        return camera.resized(*size), image
    _check_shape(path, size, (lens.width, lens.height), f", or {whole[0]}x{whole[1]} undistorted")
    scale = size[0] / lens.width, size[1] / lens.height
    camera = camera.resized(
        *(max(1, round(side * by)) for side, by in zip(whole, scale, strict=True))
    )
    return camera, _undistorted(path, image, lens, camera)


def _divides(size: tuple[int, int], whole: tuple[int, int]) -> bool:
    """Whether `size` is `whole`, or `whole` divided by an integer and rounded up or down."""
    by = max(1, round(whole[0] / size[0]))
    return all(abs(full / by - side) < 1 for full, side in zip(whole, size, strict=True))


def _check_shape(
    path: Path, size: tuple[int, int], expected: tuple[int, int], others: str = ""
) -> None:
    width, height = expected
    # Sides rounded down, as in nerfstudio's images_8, may differ by more than a pixel.
    if abs(size[0] * height / width - size[1]) > 1 and not _divides(size, expected):
        raise InvalidInput(
            f"{path}: {size[0]}x{size[1]} pixels, expected the shape of {width}x{height}{others}"
        )


def _undistorted(
    path: Path, image: NDArray[np.float32], lens: Lens, camera: Camera
) -> NDArray[np.float32]:
    """Resample a photograph of the lens to the camera's view."""
    cv2 = needed("cv2", f"{path}: a distorted photograph")
    scale = image.shape[1] / lens.width, image.shape[0] / lens.height
    maps = _distorted_pixels(lens, camera, scale) if lens.r8 else _maps(cv2, lens, camera, scale)
    return cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _maps(cv2: Any, lens: Lens, camera: Camera, scale: tuple[float, float]) -> list[NDArray]:
    """Photograph columns and rows for each pixel of the camera, in OpenCV's convention."""
    x, y = scale
    source = _matrix(x * lens.fx, y * lens.fy, x * lens.cx, y * lens.cy)
    target = _matrix(camera.fx, camera.fy, camera.cx, camera.cy)
    find_maps = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
    size = camera.width, camera.height
    return find_maps(source, np.array(lens.coefficients), np.eye(3), target, size, cv2.CV_32FC1)


def _distorted_pixels(
    lens: Lens, camera: Camera, scale: tuple[float, float]
) -> NDArray[np.float32]:
    """The same for a lens that OpenCV does not support."""
    maps = np.empty((2, camera.height, camera.width), np.float32)
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    for row in range(camera.height):
        y = np.full_like(x, (row + 0.5 - camera.cy) / camera.fy)
        maps[:, row] = lens.distort(np.stack([x, y])) * np.transpose([scale]) - 0.5
    return maps


def _matrix(fx: float, fy: float, cx: float, cy: float) -> NDArray[np.float64]:
    """OpenCV's camera matrix, in which the centre of the first pixel is at 0."""
    return np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1]])
