"""Fuzzing targets: readers of files, which may reject an input only with our own errors."""

from __future__ import annotations

import gzip
import io
import json
import os
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import browser
import foreign
import numpy as np
from damage import ENTRY, HEADER, SECTIONS, with_checksums
from moving_scenes import encoded, varied
from scenes import SmallBlocks, encode_by, made_up_guide, random_scene, seen_from, with_far

from gs_codec.batch.ledger import Record, open_ledger
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import read_image
from gs_codec.codecs import decode_part, encode_parts, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.lossless.columns import read_integers, write_integers
from gs_codec.codecs.moving import decode_frames
from gs_codec.codecs.part import Part
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import described, read_file
from gs_codec.egs.frame_sections import timeline_of
from gs_codec.errors import GsCodecError
from gs_codec.format_table import STREAMED, TILESET, UNBUNDLED
from gs_codec.formats import checkpoint as of_trainers
from gs_codec.formats.gltf.compressed import pack_gltf_spz
from gs_codec.formats.gltf.scene import pack_gltf
from gs_codec.formats.pickled import parse_pickle
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.sog.files import parse_meta, read_pixels
from gs_codec.formats.sog.writer import pack_sog
from gs_codec.formats.usd.scene import pack_usd
from gs_codec.formats.zip_file import write_zip
from gs_codec.levels.adding import add_levels
from gs_codec.levels.streaming import stream_levels
from gs_codec.levels.tiling import tile_levels
from gs_codec.preparation.adam import (
    AdamState,
    Checkpoint,
    new_state,
    read_checkpoint,
    write_checkpoint,
)
from gs_codec.report import SCHEMA
from gs_codec.runtime.atomic import write_files
from gs_codec.runtime.optional import is_available
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS, Scene
from viewer.scenes.opened import read_pruned

#: Maximum bytes of a decoded scene.
_MOST = 1 << 22

#: Number of Gaussians of the initial streams.
_COUNT = 60

_VIEW = Camera("seen", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0.0, 0.0, -4.0]))


@dataclass(frozen=True)
class Target:
    """A reader, and valid inputs to start from.

    Attributes
    ----------
    read : callable
        ``read(data)``; raises `GsCodecError` if it rejects the data.
    seeds : callable
        Makes valid inputs.
    """

    read: Callable[[bytes], object]
    seeds: Callable[[], list[bytes]]

    def check(self, data: bytes) -> None:
        """Read an input; errors must have one line."""
        try:
            self.read(data)
        except GsCodecError as error:
            if not str(error) or "\n" in str(error):
                raise AssertionError(f"not one line: {error!r}") from error


def _from_file(read: Callable[[Path], object], suffix: str, data: bytes) -> object:
    """Read an input from a file, which is in memory if the system supports it."""
    with tempfile.TemporaryDirectory(dir=_memory_folder()) as folder:
        path = Path(folder) / f"input{suffix}"
        path.write_bytes(data)
        return read(path)


def _memory_folder() -> str | None:
    return "/dev/shm" if os.path.isdir("/dev/shm") else None


def _to_file(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"seed{suffix}"
        write(path)
        return path.read_bytes()


def _stream_of(data: bytes) -> bytes:
    """The stream after the first byte, which tells whether size and checksums are corrected."""
    stream = bytearray(data[1:])
    if data[0] & 8:
        _fit_last(stream)
    if data[0] & 1 and len(stream) > HEADER:
        stream = with_checksums(stream)
    return bytes(stream)


def _decode(data: bytes) -> None:
    """Decode all or a part; the first byte selects which, and whether checksums are corrected."""
    if not data:
        return
    stream = _stream_of(data)
    part = Part()
    if data[0] & 2:
        part = Part((-0.5, -0.5, -0.5, 0.5, 0.5, 0.5))
    if data[0] & 4:
        part = replace(part, sh_degree=0)
    if data[0] & 16:
        part = Part(level=1)
    if data[0] & 32:
        part = Part(view=_VIEW)
    inspect_bytes(stream)
    scene, _ = decode_part(stream, part, 1, _MOST)
    for group in GROUPS if data[0] & 1 else ():
        getattr(scene, group).sum(dtype=np.float64)


def _fit_last(stream: bytearray) -> None:
    """Adjust the length of the last section to the remaining bytes."""
    if len(stream) < HEADER:
        return
    table = HEADER + ENTRY * struct.unpack_from("<I", stream, SECTIONS)[0]
    if HEADER < table <= len(stream) - 4:
        sizes = [struct.unpack_from("<Q", stream, at + 8)[0] for at in range(HEADER, table, ENTRY)]
        left = len(stream) - table - 4 - sum(-(-size // 4) * 4 for size in sizes[:-1])
        last = struct.unpack_from("<Q", stream, table - ENTRY + 8)[0]
        if left >= 0 and -(-last // 4) * 4 != left:
            struct.pack_into("<Q", stream, table - ENTRY + 8, left)


def _streams() -> list[bytes]:
    streams = []
    for profile in PROFILE_CHOICES:
        for degree in (0, 1, 3):
            scene = random_scene(_COUNT, degree, seed=degree)
            if degree == 1:
                extra = {"label": np.arange(_COUNT, dtype="<i4")}
                scene = replace(scene, extra=extra, comments=("a comment",))
            streams.append(encode_scene(scene, Config(profile, extra="keep", block_size=1024))[0])
    streams.append(encode_by(random_scene(_COUNT, 2), Config("m"), made_up_guide()))
    streams.append(encode_scene(with_far(random_scene(_COUNT, 1), 3), Config("m"))[0])
    streams.append(encode_scene(seen_from(random_scene(_COUNT, 1), 1, scale=100.0), Config("m"))[0])
    found = [bytes([first]) + stream for stream in streams for first in (9, 11, 13)]
    return found + [bytes([first]) + _levels() for first in (9, 25, 41)]


def _decode_frames(data: bytes) -> None:
    """Decode the frames of a sequence; the first byte is as in `_decode`."""
    if not data:
        return
    file = read_file(_stream_of(data), described)
    with using_threads(1):
        for scene in decode_frames(file, timeline_of(file), max_bytes=_MOST):
            scene.f_rest.sum(dtype=np.float64)


def _sequences() -> list[bytes]:
    scenes = (
        random_scene(20, 0),
        with_far(random_scene(20, 1), 3),
        seen_from(random_scene(20, 2), 1, scale=100.0),
    )
    return [b"\x09" + encoded(varied(scene, 4, share=0.7), 16, group=3) for scene in scenes]


def _levels() -> bytes:
    """A stream with a coarser level, in blocks smaller than options allow."""
    config = SmallBlocks("m", lod=True)
    parts = encode_parts(random_scene(_COUNT, 1, seed=4), config)
    return b"".join(add_levels(*parts, config)[0])


def _browser_streams() -> list[bytes]:
    profiles = [profile for profile in PROFILE_CHOICES if profile != "lossless"]
    streams = [
        encode_scene(random_scene(_COUNT, 2, seed=7), Config(profile))[0] for profile in profiles
    ]
    streams.append(encode_scene(with_far(random_scene(_COUNT, 1), 3), Config("m"))[0])
    streams.append(encode_scene(seen_from(random_scene(_COUNT, 1), 1, scale=100.0), Config("m"))[0])
    levels = SmallBlocks("m", lod=True)
    parts = encode_parts(random_scene(_COUNT, 1, seed=8), levels)
    streams.append(b"".join(add_levels(*parts, levels)[0]))
    return [bytes([first]) + stream for stream in streams for first in (0, 1)] + [
        b"\1" + path.read_bytes()
        for path in sorted((Path(__file__).parents[1] / "golden").glob("*.egs"))
        if not {"lossless", "sequence"} & {*path.stem.split("-")} and path.stat().st_size < 7_000
    ]


def _scene_file(suffix: str) -> Callable[[bytes], object]:
    from gs_codec.files.scenes import read_scene

    return partial(_from_file, partial(read_scene, extra="keep"), suffix)


def _plys() -> list[bytes]:
    scenes: Iterable[Scene] = (random_scene(8, degree, seed=degree) for degree in range(4))
    files = [_to_file(partial(write_ply, scene=scene), ".ply") for scene in scenes]
    ascii_scene = b"ply\nformat ascii 1.0\ncomment SplatRenderMode: mip\nelement vertex 1\n"
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    ascii_scene += b"".join(f"property float {name}\n".encode() for name in names.split())
    return [*files, ascii_scene + b"end_header\n" + b"0.5 " * 14 + b"\n"]


def _cameras() -> list[bytes]:
    entry = {
        "id": 0, "img_name": "00001", "width": 400, "height": 266, "fx": 350.0, "fy": 350.0,
        "position": [0.0, 1.0, -3.0], "rotation": np.eye(3).tolist(), "split": "test",
    }  # fmt: skip
    pose = {"position": [0.0, 1.0, 5.0], "target": [0.0, 0.0, 0.5], "fov": 75}
    step = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50.0}
    values = {"position": 2 * pose["position"], "target": 2 * pose["target"], "fov": [50, 60]}
    frame = {"file_path": "./a.png", "transform_matrix": np.eye(4).tolist()}
    view = {"w": 400, "h": 266, "cx": 200.0, "cy": 133.0, "fl_x": 350.0, "fl_y": 350.0}
    bent = {
        "camera_model": "OPENCV",
        "k1": -0.05,
        "k2": 0.01,
        "p1": 0.001,
        "train_filenames": ["a"],
    }
    wide = {"camera_model": "OPENCV_FISHEYE", "camera_angle_x": 1.2, "w": 40, "h": 30, "k1": 0.05}
    files = (
        [entry, {**entry, "img_name": "b", "split": "train"}],
        {**view, **bent, "frames": [frame, {**frame, "file_path": "b", "is_fisheye": True}]},
        {**wide, "frames": [frame]},
        {"render_width": 40, "render_height": 30, "camera_path": [step, step]},
        {"camera": {"fov": 60}, "poseSets": [{"poses": [pose, {**pose, "target": [1, 2, 3]}]}]},
        {
            "cameras": [{"initial": pose}],
            "animTracks": [{"keyframes": {"times": [0, 30], "values": values}}],
        },
    )
    return [json.dumps(each).encode() for each in files]


def _images() -> list[bytes]:
    from PIL import Image

    image = Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    seeds = []
    for kind in ("PNG", "JPEG", "WEBP", "TIFF", "BMP"):
        file = io.BytesIO()
        image.save(file, kind)
        seeds.append(file.getvalue())
    return seeds


def _first_state() -> AdamState:
    return new_state(np.zeros((4, 3), np.float32))


def _packed_plys() -> list[bytes]:
    return [
        foreign.ply_file(list(foreign.packed_rows(40, degree, degree).items()))
        for degree in range(4)
    ]


def _splats() -> list[bytes]:
    return [foreign.splat_rows(8, seed=1).tobytes()]


def _spzs() -> list[bytes]:
    extension = struct.pack("<III", 0xADBE0003, 4, 6)
    files = []
    for version in range(1, 5):
        streams = foreign.spz_streams(12, version, version - 1, seed=version)
        sound = partial(foreign.spz_file, streams, 12, version, version - 1)
        files += [sound(flags=1), sound(flags=2, extensions=extension)]
    tree = struct.pack("<12H12I", 11, *[0] * 11, 1, *[0] * 11)
    streams = foreign.spz_streams(12, 2, 4, seed=2)
    return [*files, foreign.spz_file(streams, 12, 2, 4, flags=0x80, extensions=tree)]


def _unzipped_spzs() -> list[bytes]:
    return [gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data for data in _spzs()]


def _gltfs() -> list[bytes]:
    packs = (pack_gltf, pack_gltf, pack_gltf_spz, pack_gltf_spz)
    return [
        pack(random_scene(4, degree), as_text=bool(degree % 2))[0]
        for degree, pack in enumerate(packs)
    ]


def _ksplats() -> list[bytes]:
    files = []
    for level, degree in ((0, 0), (1, 1), (2, 2)):
        rows = foreign.ksplat_rows(6, level, degree, seed=level)
        files.append(foreign.ksplat_file(level, [(degree, rows, 4, [2], np.ones((2, 3)))]))
    return files


def _lcc(name: str, folder: Path, data: bytes) -> object:
    """A scene with one of its files replaced."""
    from gs_codec.files.scenes import read_scene

    write_files(folder, foreign.lcc_files("Quality")[0] | {name: data})
    return read_scene(folder / "a.lcc")


def _lcc_seeds(name: str) -> list[bytes]:
    return [foreign.lcc_files("Quality")[0][name]]


@cache
def _lcc2_parts() -> dict[str, bytes]:
    return {f"{n}.sog": pack_sog(random_scene(4, 0, seed=n))[0] for n in range(4)}


def _lcc2(folder: Path, data: bytes) -> object:
    from gs_codec.files.scenes import read_scene

    write_files(folder, {**_lcc2_parts(), "a.lcc2": data})
    return read_scene(folder / "a.lcc2")


def _lcc2s() -> list[bytes]:
    return [foreign.lcc2_files([*_lcc2_parts()], earlier)["a.lcc2"] for earlier in (False, True)]


_ROUNDED = {"alpha": "r8", "rgb": "r8_delta", "scales": "ln_0r8", "orientation": "oct88r8"}


def _rad_chunks() -> list[tuple[dict, bytes]]:
    rounded = {**_ROUNDED, "sh1": "s8", "sh2": "s8_delta"}
    labelled = foreign.rad_values(6, 1, seed=3)
    labelled |= {"sh1_code": labelled.pop("sh1"), "sh_label": np.arange(6)[None]}
    return [
        foreign.rad_chunk(foreign.rad_values(6, 2, seed=1, levels=True), rounded),
        foreign.rad_chunk(foreign.rad_values(6, 0, seed=2), {"center": "f16", "scales": "ln_f16"}),
        foreign.rad_chunk(labelled, {}),
    ]


def _rads() -> list[bytes]:
    return [foreign.rad_file([chunk])[""] for chunk in _rad_chunks()]


def _rad_description(data: bytes) -> object:
    """A file or a chunk with this description."""
    chunk, payload = _rad_chunks()[0]
    if data.startswith(b'{"version": 1, "base"'):
        return _scene_file(".rad")(foreign.rad_file([(data, payload)], count=6, maxSh=2)[""])
    whole = foreign.rad_file([(chunk, payload)])[""]
    start = whole.index(b"RADC")
    return _scene_file(".rad")(foreign.rad_described(b"RAD0", data) + whole[start:])


def _rad_descriptions() -> list[bytes]:
    whole = _rads()[0]
    size = int.from_bytes(whole[4:8], "little")
    return [whole[8 : 8 + size], json.dumps(_rad_chunks()[0][0]).encode()]


def _usds() -> list[bytes]:
    return [pack_usd(random_scene(4, degree), suffix)[0] for degree, suffix in _USDS]


_USDS = ((0, ".usda"), (1, ".usda"), (0, ".usdc"), (0, ".usdz"))


def _pcodec(data: bytes) -> None:
    """A column of a lossless stream; the first byte is the number of values."""
    if data and data[0]:
        read_integers(memoryview(data)[1:], data[0], "column")


def _columns() -> list[bytes]:
    rng = np.random.default_rng(5)
    columns = (np.arange(60), rng.integers(0, 9, 200), rng.integers(0, 1 << 32, 30), np.zeros(9))
    return [bytes([len(each)]) + write_integers(each.astype(np.uint32)) for each in columns]


def _trainers() -> list[bytes]:
    return [
        _to_file(partial(of_trainers.write_checkpoint, scene=random_scene(3, degree)), suffix)
        for degree, suffix in ((0, ".pt"), (1, ".pt"), (0, ".ckpt"))
    ]


def _pickles() -> list[bytes]:
    seeds = []
    for data in _trainers():
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            seeds.append(archive.read("archive/data.pkl"))
    return seeds


def _sogs() -> list[bytes]:
    return [
        foreign.sog_file(*foreign.sog_parts(8, version, degree, seed=degree))
        for version, degree in ((1, 0), (1, 3), (2, 0), (2, 1))
    ]


def _sog_metas() -> list[bytes]:
    pairs = ((1, 0), (1, 2), (2, 0), (2, 3))
    parts = [foreign.sog_parts(8, version, degree, seed=1)[0] for version, degree in pairs]
    return [json.dumps(meta).encode() for meta in parts]


def _lod_meta(folder: Path, data: bytes) -> object:
    """A `lod-meta.json` next to the files of a scene."""
    from gs_codec.files.scenes import read_scene

    write_files(folder, {**_streamed(), STREAMED: data})
    return read_scene(folder / STREAMED)


def _tileset(folder: Path, data: bytes) -> object:
    """A `tileset.json` next to the files of a scene, which also have a tileset."""
    from gs_codec.files.scenes import read_scene

    own = _tiled()
    for name, content in {**own, "inner.json": own[TILESET], TILESET: data}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return read_scene(folder / TILESET)


@cache
def _tiled() -> dict[str, bytes]:
    return tile_levels(random_scene(30, 0, seed=3), Config("m"), (8.5, 47.4, 400.0), most=16)[0]


def _tilesets() -> list[bytes]:
    tiles: list[dict[str, Any]] = [{"content": {"uri": "tiles/1/0.glb"}, "refine": "ADD"}]
    shift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]
    tiles[0]["children"] = [{"contents": [{"url": "inner.json"}], "transform": shift}]
    other = {"asset": {"version": "1.0"}, "geometricError": 1, "root": tiles[0]}
    return [_tiled()[TILESET], json.dumps(other).encode()]


@cache
def _ssogs() -> list[bytes]:
    """Zips of streamed SOG as written, and with bundles in place of folders."""
    plain, bundled = io.BytesIO(), io.BytesIO()
    files = _streamed()
    write_zip(plain, files)
    meta = json.loads(files[STREAMED])
    units = {name: f"{name.partition('/')[0]}.sog" for name in meta["filenames"]}
    bundles: dict[str, bytes] = {}
    for name, unit in units.items():
        folder, data = name.removesuffix(UNBUNDLED), io.BytesIO()
        own = {n.removeprefix(folder): b for n, b in files.items() if n.startswith(folder)}
        write_zip(data, own)
        bundles[unit] = data.getvalue()
    meta["filenames"] = [*units.values()]
    write_zip(bundled, bundles | {STREAMED: json.dumps(meta).encode()})
    return [plain.getvalue(), bundled.getvalue()]


def _streamed() -> dict[str, bytes]:
    return dict(
        stream_levels(random_scene(300, 0, seed=3), SmallBlocks("m", block_size=64), 128)[0]
    )


def _pixels() -> list[bytes]:
    images = foreign.sog_parts(8, 2, 1, seed=1)[1]
    return [write(pixels) for pixels in images.values() for write in (foreign.webp, foreign.png)]


def _checkpoints() -> list[bytes]:
    done = Checkpoint(_first_state(), np.zeros(2), np.ones(2))
    return [_to_file(partial(write_checkpoint, digest="digest", checkpoint=done), ".npz")]


def _colmap(folder: Path, data: bytes) -> None:
    """A binary model; the first bytes of the input say where the cameras end."""
    end = int.from_bytes(data[:2], "little")
    (folder / "cameras.bin").write_bytes(data[2 : 2 + end])
    (folder / "images.bin").write_bytes(data[2 + end :])
    read_cameras(folder)


def _models() -> list[bytes]:
    """A pinhole camera, or one with distortion, and an image without points."""
    view = (400, 266, 350.0, 350.0, 200.0, 133.0)
    cameras = (
        struct.pack("<QiiQQ4d", 1, 7, 1, *view),
        struct.pack("<QiiQQ8d", 1, 7, 4, *view, -0.05, 0.01, 0.001, 0.0),
        struct.pack("<QiiQQ8d", 1, 7, 5, *view, 0.05, 0.01, 0.001, 0.0),
    )
    image = struct.pack("<Qi7di", 1, 3, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 3.0, 7)
    image += b"view.png\0" + struct.pack("<Q", 0)
    return [struct.pack("<H", len(camera)) + camera + image for camera in cameras]


def _pruned(folder: Path, data: bytes) -> None:
    """A pruning report; the labels come first."""
    end = int.from_bytes(data[:2], "little")
    (folder / "labels.npy").write_bytes(data[2 : 2 + end])
    (folder / "report.json").write_bytes(data[2 + end :])
    cloud = SimpleNamespace(
        file_count=5, name="scene", whole=None, positions=np.zeros((5, 3), np.float32)
    )
    read_pruned(folder, cloud)  # type: ignore[arg-type]


def _reports() -> list[bytes]:
    file = io.BytesIO()
    np.save(file, np.array([0, 1, 0, 2, 0], np.uint8))
    labels = file.getvalue()
    return [struct.pack("<H", len(labels)) + labels + b'{"removed": {"scale": 1, "opacity": 1}}']


def _ledger(path: Path) -> None:
    with open_ledger(path, resume=True):
        pass


def _ledgers() -> list[bytes]:
    done = Record(
        *("a.ply", "a.egs", "digest", {"numpy": "2"}, 100, 5, "0f"),
        output_bytes=10, output_sha256="1e", gaussians=7, ratio=10.0, bits_per_gaussian=11.4,
    )  # fmt: skip
    failed = Record("b.ply", "b.egs", error={"kind": "InvalidInput", "text": "b.ply: empty"})
    lines = [
        json.dumps({"schema": SCHEMA} | asdict(record)).encode() + b"\n"
        for record in (done, failed)
    ]
    return [b"".join(lines), lines[0] + lines[1][:40]]


def _in_folder(read: Callable[[Path, bytes], object], data: bytes) -> object:
    with tempfile.TemporaryDirectory(dir=_memory_folder()) as folder:
        return read(Path(folder), data)


TARGETS = {
    "decode": Target(_decode, _streams),
    "sequence": Target(_decode_frames, _sequences),
    **({"browser": Target(browser.compare, _browser_streams)} if browser.NODE else {}),
    "ply": Target(_scene_file(".ply"), _plys),
    "packed-ply": Target(_scene_file(".ply"), _packed_plys),
    "splat": Target(_scene_file(".splat"), _splats),
    "spz": Target(_scene_file(".spz"), lambda: [*_spzs(), *_unzipped_spzs()]),
    "gltf": Target(_scene_file(".gltf"), _gltfs),
    "ksplat": Target(_scene_file(".ksplat"), _ksplats),
    **{
        f"lcc-{name.partition('.')[0]}": Target(
            partial(_in_folder, partial(_lcc, name)), partial(_lcc_seeds, name)
        )
        for name in ("a.lcc", "index.bin", "environment.bin")
    },
    "lcc2": Target(partial(_in_folder, _lcc2), _lcc2s),
    "rad": Target(_scene_file(".rad"), _rads),
    "rad-description": Target(_rad_description, _rad_descriptions),
    "pcodec": Target(_pcodec, _columns),
    **({"usd": Target(_scene_file(".usd"), _usds)} if is_available("pxr") else {}),
    "pickle": Target(parse_pickle, _pickles),
    "trainer": Target(_scene_file(".pt"), _trainers),
    "sog": Target(_scene_file(".sog"), _sogs),
    "ssog": Target(_scene_file(".ssog"), _ssogs),
    "sog-meta": Target(parse_meta, _sog_metas),
    "lod-meta": Target(partial(_in_folder, _lod_meta), lambda: [bytes(_streamed()[STREAMED])]),
    "tileset": Target(partial(_in_folder, _tileset), _tilesets),
    "sog-image": Target(partial(read_pixels, name="image", most=1 << 16), _pixels),
    "cameras": Target(partial(_from_file, read_cameras, ".json"), _cameras),
    "image": Target(partial(_from_file, read_image, ".png"), _images),
    "colmap": Target(partial(_in_folder, _colmap), _models),
    "ledger": Target(partial(_from_file, _ledger, ".jsonl"), _ledgers),
    "pruned": Target(partial(_in_folder, _pruned), _reports),
    "checkpoint": Target(
        partial(
            _from_file, partial(read_checkpoint, digest="digest", fresh=_first_state()), ".npz"
        ),
        _checkpoints,
    ),
}
