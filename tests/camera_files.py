"""Handwritten camera files of several programs, valid and invalid."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.errors import InvalidInput

#: COLMAP's camera models by number.
MODELS = {
    "SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4,
    "OPENCV_FISHEYE": 5, "FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8,
    "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10, "EQUIRECTANGULAR": 17,
}  # fmt: skip

#: A camera at (1, 2, 3) that looks along x, with z up: right is -y, down is -z.
RIGHT_DOWN_FORWARD = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]

#: Position of that camera.
POSITION = [1.0, 2.0, 3.0]

#: World-to-camera quaternion of that camera: R has the rows right, down and forward, and t is -R
#: (1, 2, 3).
QUATERNION = (0.5, 0.5, -0.5, 0.5)

#: See `QUATERNION`.
TRANSLATION = (2.0, 3.0, -1.0)

#: A number that overflows every float.
HUGE = int("9" * 4000)

#: A point 4 in front of that camera, 1 to its right and 2 above it.
POINT = (5.0, 1.0, 5.0)

#: Camera-to-world matrix of that camera: the columns are right (-y), up (z) and back (-x).
POSE = [[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]

#: `POSE`, row by row.
MATRIX = [value for row in POSE for value in row]

#: Field of view of 150 pixels at a distance of 200, in degrees.
FOV = math.degrees(2 * math.atan(0.75))

#: Fields shared by all frames of a transforms.json.
SHARED = {"fl_x": 100.0, "fl_y": 200.0, "cx": 190.0, "cy": 160.0, "w": 400, "h": 300}


class Intrinsics(NamedTuple):
    camera_id: int = 1
    model: str | int = "PINHOLE"
    width: int = 400
    height: int = 300
    parameters: Sequence[float] = (100.0, 200.0, 190.0, 160.0)


class Image(NamedTuple):
    name: str | bytes = "a.jpg"
    quaternion: Sequence[float] = QUATERNION
    translation: Sequence[float] = TRANSLATION
    camera_id: int = 1
    image_id: int = 1
    points: int = 0


def raw_name(image: Image) -> bytes:
    return image.name if isinstance(image.name, bytes) else image.name.encode()


def cameras_bin(cameras: Sequence[Intrinsics]) -> bytes:
    data = struct.pack("<Q", len(cameras))
    for camera in cameras:
        model = MODELS[camera.model] if isinstance(camera.model, str) else camera.model
        data += struct.pack("<IiQQ", camera.camera_id, model, camera.width, camera.height)
        data += struct.pack(f"<{len(camera.parameters)}d", *camera.parameters)
    return data


def images_bin(images: Sequence[Image]) -> bytes:
    data = struct.pack("<Q", len(images))
    for image in images:
        data += struct.pack("<I7d", image.image_id, *image.quaternion, *image.translation)
        data += struct.pack("<I", image.camera_id) + raw_name(image) + b"\0"
        # A point at (0.5, 1.5) without a 3D point.
        data += struct.pack("<Q", image.points) + struct.pack("<ddQ", 0.5, 1.5, 2**64 - 1) * (
            image.points
        )
    return data


def cameras_txt(cameras: Sequence[Intrinsics]) -> bytes:
    lines = ["# Camera list", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for camera in cameras:
        fields = [camera.camera_id, camera.model, camera.width, camera.height, *camera.parameters]
        lines.append(" ".join(str(field) for field in fields))
    return "\n".join(lines).encode() + b"\n"


def images_txt(images: Sequence[Image]) -> bytes:
    lines = [b"# Image list with two lines of data per image:", b""]
    for image in images:
        fields = [image.image_id, *image.quaternion, *image.translation, image.camera_id]
        lines.append(" ".join(str(field) for field in fields).encode() + b" " + raw_name(image))
        lines.append(b" ".join([b"0.5 1.5 -1"] * image.points))
    return b"\n".join(lines) + b"\n"


WRITERS = {".bin": (cameras_bin, images_bin), ".txt": (cameras_txt, images_txt)}

both_forms = pytest.mark.parametrize("suffix", WRITERS)


def write_model(
    folder: Path,
    suffix: str,
    images: Sequence[Image] = (Image(),),
    cameras: Sequence[Intrinsics] = (Intrinsics(),),
) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    write_cameras, write_images = WRITERS[suffix]
    (folder / f"cameras{suffix}").write_bytes(write_cameras(cameras))
    (folder / f"images{suffix}").write_bytes(write_images(images))
    return folder


def inria_entry(**changes: Any) -> dict[str, Any]:
    entry = {
        "id": 0,
        "img_name": "a",
        "width": 400,
        "height": 300,
        "position": POSITION,
        "rotation": RIGHT_DOWN_FORWARD,
        "fy": 200.0,
        "fx": 100.0,
    }
    return entry | changes


def write_json(path: Path, *entries: Any) -> Path:
    path.write_text(json.dumps(entries))
    return path


def pixel(camera: Camera, point: Sequence[float]) -> tuple[float, float]:
    x, y, z = camera.rotation @ (np.array(point) - camera.position)
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


def assert_valid(cameras: list[Camera]) -> None:
    assert cameras
    for camera in cameras:
        assert camera.name.isprintable()
        assert isinstance(camera.width, int)
        assert isinstance(camera.height, int)
        assert all(map(math.isfinite, (camera.fx, camera.fy, camera.cx, camera.cy)))
        assert camera.position.shape == (3,)
        assert np.isfinite(camera.position).all()
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)


def assert_refused(given: Path, message: str = ".", told: Path | None = None) -> None:
    """Reading fails in one short line that begins with the path `told`, else with `given`."""
    with pytest.raises(InvalidInput, match=message) as caught:
        read_cameras(given)
    text = str(caught.value)
    assert text.startswith(f"{told or given}: ")
    assert text.isprintable()
    assert len(text) - len(str(told or given)) < 400


def random_model(seed: int) -> tuple[list[Image], list[Intrinsics]]:
    rng = np.random.default_rng(seed)
    cameras = [
        Intrinsics(7, "PINHOLE", 640, 480, rng.uniform(100, 900, 4).tolist()),
        Intrinsics(2, "SIMPLE_PINHOLE", 800, 600, rng.uniform(100, 900, 3).tolist()),
    ]
    images = [
        Image(
            f"{'left' if i % 2 else 'right'}/été {i}.jpg",
            (rng.uniform(0.1, 9) * rng.normal(size=4)).tolist(),
            rng.normal(scale=10, size=3).tolist(),
            (7, 2)[i % 2],
            100 - i,
            int(rng.integers(0, 5)),
        )
        for i in range(20)
    ]
    return images, cameras


def read_damaged(path: Path) -> bool:
    """Whether a damaged file was read; any result but valid cameras or a refusal fails."""
    try:
        cameras = read_cameras(path)
    except InvalidInput as error:
        lines = str(error).splitlines()
    else:
        assert_valid(cameras)
        return True
    assert len(lines) == 1
    return False


def damaged(good: bytes, rng: np.random.Generator) -> bytes:
    """Change some bytes; sometimes remove or repeat a part."""
    data = bytearray(good)
    for position in rng.integers(0, len(data), rng.integers(1, 6)):
        data[position] = rng.integers(0, 256)
    first, last = sorted(rng.integers(0, len(data), 2))
    match rng.integers(0, 8):
        case 0:
            del data[first:last]
        case 1:
            data[first:first] = data[first:last]
    return bytes(data)


def step(**changes: Any) -> dict[str, Any]:
    """A frame of a camera path of nerfstudio."""
    return {"camera_to_world": MATRIX, "fov": FOV, "aspect": 4 / 3} | changes


def camera_path(*steps: Any, **changes: Any) -> dict[str, Any]:
    """A camera path of nerfstudio."""
    whole = {
        "default_fov": 50.0,
        "keyframes": [{"matrix": MATRIX, "fov": FOV, "aspect": 4 / 3}],
        "camera_type": "perspective",
        "render_width": 400,
        "render_height": 300,
        "fps": 24,
        "seconds": 4,
        "is_cycle": False,
        "camera_path": list(steps) or [step()],
    }
    return whole | changes


def pose(**changes: Any) -> dict[str, Any]:
    """A pose of SuperSplat."""
    return {"position": [0, 0, 5], "target": [0, 0, 0], "fov": 90} | changes


def project(*poses: Any, **changes: Any) -> dict[str, Any]:
    """The document.json of a SuperSplat project."""
    named = [{"name": f"camera_{i}", "frame": 30 * i} | each for i, each in enumerate(poses)]
    sets = [{"name": "set0", "poses": named}]
    return {"version": 0, "camera": {"fov": 75}, "poseSets": sets, "splats": []} | changes


def frame(name: str = "images/a.jpg", **changes: Any) -> dict[str, Any]:
    """A frame of a transforms.json."""
    return {"file_path": name, "transform_matrix": POSE} | changes


def write_transforms(path: Path, *frames: Any, **shared: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**shared, "frames": frames or [frame()]}))
    return path
