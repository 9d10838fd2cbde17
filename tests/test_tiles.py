"""3D Tiles: the tree and its files, places on the earth, rejected input, and CesiumJS."""

from __future__ import annotations

import base64
import json
import math
import shutil
import struct
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from orbits import cameras, facing
from other_programs import PACKAGES
from scenes import SmallBlocks, assert_same_floats, random_scene
from typer.testing import CliRunner
from web_pages import CHROMIUM, NODE, decibels, drawn, seen

from gs_codec.cameras.camera import Camera
from gs_codec.cli.main import app
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.format_table import TILESET
from gs_codec.formats.coordinates import state_system, turn_axes
from gs_codec.formats.gltf.scene import pack_gltf
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.registry import check_file, open_scene, overview_of, scene_files
from gs_codec.formats.tiles.earth import frame_at, place_of
from gs_codec.levels.building import error_of
from gs_codec.levels.tiling import Blocks, tile_levels
from gs_codec.runtime.atomic import write_files
from gs_codec.scene import ANTIALIASED, Scene
from samples.generate import generate

MOST = 200
CONFIG = Config(format="spz")
AT = (8.54, 47.37, 410.0)


def tiled(folder: Path, scene: Scene, **options: Any) -> dict[str, Any]:
    """Write the files of a scene with small tiles; return its `tileset.json`."""
    files, _ = tile_levels(scene, CONFIG, **{"most": MOST, **options})
    write_files(folder, files)
    return json.loads(files[TILESET])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(1150, 2, seed=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene) -> Path:
    """A scene with six tiles at the finest of three levels."""
    folder = tmp_path_factory.mktemp("tiles")
    tiled(folder, scene)
    return folder


@pytest.fixture
def copy(folder, tmp_path) -> Path:
    shutil.copytree(folder, tmp_path / "copy")
    return tmp_path / "copy"


def below(tile: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A tile and all tiles below."""
    yield tile
    for child in tile.get("children", []):
        yield from below(child)


def corners(tile: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The box of a tile, in the axes of glTF."""
    box = np.array(tile["boundingVolume"]["box"]).reshape(4, 3)
    half = np.diag(box[1:])
    np.testing.assert_array_equal(box[1:], np.diag(half))
    east, north, up = box[0]
    return (
        np.array([east, up, -north]) - half[[0, 2, 1]],
        np.array([east, up, -north]) + half[[0, 2, 1]],
    )


# Writing


def test_the_tree_has_the_layout_viewers_expect(folder, scene):
    document = json.loads((folder / TILESET).read_text())
    assert document["asset"] == {"version": "1.1"}
    [needed] = [document["extensions"]["3DTILES_content_gltf"]]
    for of in ("extensionsUsed", "extensionsRequired"):
        assert needed[of] == [
            "KHR_gaussian_splatting",
            "KHR_gaussian_splatting_compression_spz_2",
        ]
    root = document["root"]
    assert root["refine"] == "REPLACE"
    assert document["geometricError"] >= root["geometricError"]
    names = [tile["content"]["uri"] for tile in below(root)]
    assert sorted(names) == sorted(
        [*(f"tiles/0/{k}.glb" for k in range(6)), "tiles/1/0.glb", "tiles/1/1.glb", "tiles/2/0.glb"]
    )
    for tile in below(root):
        children = tile.get("children", [])
        assert (tile["geometricError"] == 0) == (not children)
        low, high = corners(tile)
        for child in children:
            assert child["geometricError"] < tile["geometricError"]
            inner = corners(child)
            assert (low <= inner[0]).all()
            assert (inner[1] <= high).all()
        assert len(children) <= 4


def test_tiles_are_in_their_boxes_and_relative_to_their_middle(folder, scene):
    document = json.loads((folder / TILESET).read_text())
    count = 0
    for tile in below(document["root"]):
        part = read_scene(folder / tile["content"]["uri"], coordinates=None)
        low, high = corners(tile)
        assert (part.positions >= low[:, None] - 1e-3).all()
        assert (part.positions <= high[:, None] + 1e-3).all()
        assert part.count <= MOST
        count += part.count * ("children" not in tile)
    assert count == scene.count


def test_the_finest_tiles_are_the_scene(folder, scene):
    back = read_scene(folder / TILESET)
    assert back.count == scene.count
    assert back.coordinates == "RDF"
    rank = np.lexsort(np.round(back.positions, 2)), np.lexsort(np.round(scene.positions, 2))
    np.testing.assert_allclose(
        back.positions[:, rank[0]].mean(axis=1), scene.positions.mean(axis=1), atol=1e-3
    )
    told = overview_of(folder / TILESET)
    assert (told.format, told.count, told.sh_degree) == ("3d tiles", 1150, 2)
    assert told.file_bytes == sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
    with open_scene(folder / TILESET) as file:
        assert file.stated_bytes() == scene.float_bytes


def test_errors_are_those_of_blocks_in_16_pixels(tmp_path, scene):
    one = scene.between(0, 3 * MOST)
    document = tiled(tmp_path, one)
    assert document["root"]["geometricError"] > 0
    whole = read_scene(tmp_path / TILESET, coordinates=None)
    assert document["root"]["geometricError"] == pytest.approx(16 * error_of(whole, False), rel=0.5)


def test_centres_far_from_the_origin_keep_their_details(tmp_path):
    """2,000 units away, a scene of 2 units keeps 16 bits after the point."""
    scene = random_scene(500, 0)
    positions = (np.round(scene.positions * 64) / 64 + 2048).astype(np.float32)
    tiled(tmp_path, replace(scene, positions=positions), finest=True)
    back = read_scene(tmp_path / TILESET)
    np.testing.assert_allclose(np.sort(back.positions), np.sort(positions), atol=2**-12)
    (part, *_) = (tmp_path / "tiles/0").iterdir()
    length = int.from_bytes(part.read_bytes()[12:16], "little")
    node = json.loads(part.read_bytes()[20 : 20 + length])["nodes"][0]
    assert min(abs(value) for value in node["matrix"][12:15]) > 2000


def test_the_finest_tiles_of_an_spz_keep_its_values_and_its_size(tmp_path, scene):
    """So cameras and targets that shape an `.spz` also shape tiles made from it."""
    write_ply(tmp_path / "a.ply", scene)
    fine = Config("m", format="spz", coarseness=0.3)
    encode_file(tmp_path / "a.ply", tmp_path / "a.spz", fine)
    convert_file(tmp_path / "a.spz", tmp_path / "tiles" / TILESET)
    first, second = (
        back.take(np.lexsort(np.vstack([back.f_dc, back.f_rest])))
        for back in map(read_scene, (tmp_path / "a.spz", tmp_path / "tiles" / TILESET))
    )
    for group in ("f_dc", "f_rest", "opacity", "log_scale"):
        np.testing.assert_array_equal(getattr(second, group), getattr(first, group))
    np.testing.assert_allclose(second.positions, first.positions, atol=1e-4)
    size = (tmp_path / "a.spz").stat().st_size
    assert (tmp_path / "tiles/tiles/0/0.glb").stat().st_size < 1.05 * size + 1500  # of JSON


def test_levels_of_an_egs_are_used(tmp_path, monkeypatch):
    scene = random_scene(900, 1)
    write_ply(tmp_path / "a.ply", scene)
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", SmallBlocks("m", lod=True, block_size=64))
    used: list[Blocks | None] = []

    def watched(*of: Any, blocks: Blocks | None = None, **options: Any) -> Any:
        used.append(blocks)
        return tile_levels(*of, blocks=blocks, most=300, **options)

    monkeypatch.setattr("gs_codec.files.writing.tile_levels", watched)
    convert_file(tmp_path / "a.egs", tmp_path / "new" / TILESET)
    [blocks] = used
    assert blocks is not None
    assert blocks.size == 60
    assert [len(level.errors) for level in blocks.coarser] == [4, 1]
    names = sorted(str(p.relative_to(tmp_path / "new")) for p in (tmp_path / "new").rglob("*.glb"))
    # A tile of 240 Gaussians has four blocks.
    assert names == [*(f"tiles/0/{k}.glb" for k in range(4)), "tiles/1/0.glb", "tiles/2/0.glb"]
    np.testing.assert_allclose(
        np.sort(read_scene(tmp_path / "new/tiles/1/0.glb", coordinates=None).positions),
        np.sort(turn_axes(blocks.coarser[0].scene, "RUB").positions),
        atol=1e-2,
    )
    root = json.loads((tmp_path / "new" / TILESET).read_text())["root"]
    assert root["geometricError"] == 16 * float(blocks.coarser[1].errors[0])
    convert_file(tmp_path / "a.ply", tmp_path / "other" / TILESET)
    assert used[1] is None


def test_the_antialias_flag_is_in_all_tiles(tmp_path, scene):
    tiled(tmp_path, replace(scene, comments=(ANTIALIASED,)))
    assert read_scene(tmp_path / TILESET).antialiased
    assert read_scene(tmp_path / "tiles/1/0.glb").antialiased


@pytest.mark.one_in(2)
@pytest.mark.parametrize("threads", [1, 2])
def test_threads_do_not_matter(threads, scene, folder):
    files, _ = tile_levels(scene, replace(CONFIG, threads=threads), most=MOST)
    assert list(files)[-1] == TILESET
    for name, data in files.items():
        assert (folder / name).read_bytes() == data, name


# Places


def test_places_on_the_earth():
    np.testing.assert_allclose(frame_at((0, 0, 10))[:3, 3], [6378147, 0, 0], atol=1e-6)
    np.testing.assert_allclose(frame_at((0, 90, 0))[:3, 3], [0, 0, 6356752.3142], atol=1e-4)
    frame = frame_at((90, 0, 0))
    np.testing.assert_allclose(frame[:3, :3].T, [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-9)
    rng = np.random.default_rng(4)
    for _ in range(200):
        place = (rng.uniform(-180, 180), rng.uniform(-90, 90), rng.uniform(-400, 9000))
        found = place_of(frame_at(place)[:3, 3])
        assert found is not None
        np.testing.assert_allclose(found, place, atol=1e-6)
    assert place_of(np.zeros(3)) is None
    assert place_of(np.array([500_000.0, 5_400_000.0, 300.0])) is None


def test_a_place_changes_no_numbers_of_the_scene(folder, tmp_path, scene, caplog):
    document = tiled(tmp_path, scene, at=AT)
    matrix = np.array(document["root"]["transform"]).reshape(4, 4).T
    np.testing.assert_array_equal(matrix, frame_at(AT))
    assert_same_floats(read_scene(tmp_path / TILESET), read_scene(folder / TILESET))
    path = tmp_path / TILESET
    said = f"{path}: left out: its place on the earth, 8.5400000,47.3700000,410.000"
    assert caplog.messages == [said]


@pytest.mark.parametrize("at", [(181, 0, 0), (0, -91, 0), (0, 0, 1e6), (0, math.nan, 0)])
def test_places_elsewhere_are_refused(at, scene):
    with pytest.raises(InvalidInput, match=r"expected a longitude .* less than 100,000 metres"):
        tile_levels(scene, CONFIG, at)


# Conversions


def test_a_conversion_makes_its_folder_and_counts_all_files(tmp_path, caplog):
    write_ply(tmp_path / "scene.ply", random_scene(300, 1))
    done = convert_file(tmp_path / "scene.ply", tmp_path / "new" / TILESET, at=AT)
    files = [path for path in (tmp_path / "new").rglob("*") if path.is_file()]
    assert done.file_bytes == sum(path.stat().st_size for path in files)
    assert (done.count, done.coordinates) == (300, "RUB")
    assert not any("left out" in line for line in caplog.messages)
    assert done.lost[0].endswith("or to the steps of profile m")
    again = convert_file(tmp_path / "new" / TILESET, tmp_path / "again" / TILESET)
    assert not again.lost[0].endswith("profile m")


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "version": ({"config": Config(format="spz", spz_version=4)}, "spz_version"),
    "format": ({"config": Config(format="sog")}, "format 'sog', expected"),
    "profile": ({"config": Config("lossless")}, "profile 'lossless'"),
    "max-memory": ({"max_memory": 10**9}, "max-memory"),
    "place": ({"at": (0, 100, 0)}, "at 0,100,0: expected"),
    "coordinates": ({"coordinates": "LUF"}, "coordinates 'LUF', expected RUB"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_incompatible_options_are_refused(case, tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(30, 1))
    options, said = REFUSED[case]
    with pytest.raises(InvalidInput, match=said):
        convert_file(tmp_path / "scene.ply", tmp_path / "new" / TILESET, **options)
    assert [path.name for path in tmp_path.rglob("*")] == ["scene.ply"]


@pytest.mark.parametrize("typed", ["8,47", "8,47,x", "8,47,400,1", ""])
def test_a_place_that_is_no_place_is_refused(typed, tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(30, 1))
    command = ["convert", str(tmp_path / "scene.ply"), str(tmp_path / TILESET), f"--at={typed}"]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, InvalidInput)
    assert str(error) == f"--at {typed}: expected LON,LAT,HEIGHT"


def test_a_place_is_of_tiles_alone(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(30, 1))
    with pytest.raises(InvalidInput, match=r"at: has no effect, expected tileset\.json"):
        convert_file(tmp_path / "scene.ply", tmp_path / "a.spz", at=AT)
    with pytest.raises(InvalidInput, match="no directory"):
        convert_file(tmp_path / "scene.ply", tmp_path / "a" / "b" / TILESET)


def test_no_gaussians_and_nan_are_refused():
    with pytest.raises(InvalidInput, match=r"no Gaussians, tileset\.json needs at least one"):
        tile_levels(random_scene(0, 1), CONFIG)
    scene = random_scene(30, 1)
    scene.positions[1, 7] = np.nan
    with pytest.raises(InvalidInput, match="not finite"):
        tile_levels(scene, CONFIG)
    assert tile_levels(scene, replace(CONFIG, nonfinite="drop"))[0]


# Tilesets of others


def glb(count: int, seed: int) -> bytes:
    return pack_gltf(random_scene(count, 0, seed=seed))[0]


def made(folder: Path, root: dict[str, Any], **others: Any) -> Path:
    """A handwritten tileset with contents `a.glb`, `b.glb` and `c.glb`."""
    for seed, name in enumerate("abc"):
        (folder / f"{name}.glb").write_bytes(glb(5 + seed, seed))
    described = {"asset": {"version": "1.0"}, "geometricError": 9, "root": root, **others}
    path = folder / "any.json"
    path.write_text(json.dumps(described))
    return path


def uri(name: str) -> dict[str, Any]:
    return {"content": {"uri": name}}


@pytest.mark.parametrize(("refine", "count"), [("REPLACE", 13), ("ADD", 18), ("add", 18)])
def test_children_replace_their_parent_or_add_to_it(refine, count, tmp_path):
    root = {**uri("a.glb"), "refine": refine, "children": [uri("b.glb"), uri("./c.glb")]}
    path = made(tmp_path, root)
    assert read_scene(path).count == count
    told = overview_of(path)
    assert (told.format, told.count) == ("3d tiles", count)
    assert told.file_bytes == sum(p.stat().st_size for p in tmp_path.iterdir())


def test_buffers_of_a_tile_are_next_to_it(tmp_path):
    """Not in the current folder."""
    path = made(tmp_path, uri("in/a.gltf"))
    (tmp_path / "in").mkdir()
    document = json.loads(pack_gltf(random_scene(5, 0, seed=0), as_text=True)[0])
    data = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    document["buffers"][0]["uri"] = "a.bin"
    (tmp_path / "in/a.gltf").write_text(json.dumps(document))
    (tmp_path / "in/a.bin").write_bytes(data)
    assert_same_floats(read_scene(path), read_scene(made(tmp_path, uri("a.glb"))))
    made(tmp_path, uri("in/a.gltf"))
    assert scene_files(path) == [path, tmp_path / "in/a.gltf", tmp_path / "in/a.bin"]


def test_what_all_tiles_leave_out_is_told_once(tmp_path, caplog):
    """And once more if one of the tiles is read by itself."""
    document = json.loads(pack_gltf(random_scene(5, 0, seed=0), as_text=True)[0])
    text = json.dumps(document | {"animations": [{}]})
    path = made(tmp_path, {"children": [uri("a.gltf"), uri("b.gltf")]})
    for name in "ab":
        (tmp_path / f"{name}.gltf").write_text(text)
    read_scene(path)
    read_scene(tmp_path / "b.gltf")
    names = "a.gltf", tmp_path / "b.gltf"
    assert caplog.messages == [f"{name}: left out: animations (1)" for name in names]


def test_transforms_and_tilesets_in_tilesets(tmp_path):
    shift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1]
    turn = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    root = {"children": [{"transform": turn, **uri("in/tileset.json")}], "transform": shift}
    path = made(tmp_path, root)
    (tmp_path / "in").mkdir()
    inner = {"contents": [{"url": "x%20y.glb"}]}
    (tmp_path / "in/tileset.json").write_text(json.dumps({"root": inner}))
    (tmp_path / "in/x y.glb").write_bytes(glb(5, 0))
    plain = state_system(read_scene(tmp_path / "a.glb", coordinates=None), "RUB")
    back = read_scene(path, coordinates=None)
    x, y, z = plain.positions
    # East, north, up are x, -z, y; turned by a quarter, then shifted.
    east, north, up = z + 10, x + 20, y + 30
    np.testing.assert_allclose(back.positions, [east, up, -north], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("start", [b"\xef\xbb\xbf", b"\r\n  ", b"\xef\xbb\xbf\n"])
def test_a_tileset_may_begin_with_a_mark_and_blank_lines(start, tmp_path):
    path = made(tmp_path, uri("a.glb"))
    path.write_bytes(start + path.read_bytes())
    assert read_scene(path).count == 5


TREE = ("root", "children", 0)


def edited(*path: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    def edit(document: dict[str, Any]) -> None:
        *above, last = path
        place: Any = document
        for step in above:
            place = place[step]
        place[last] = to

    return edit


BAD = {
    "no root": (edited("root", to=None), "no root tile"),
    "root of text": (edited("root", to="a"), "no root tile"),
    "no content": (edited("root", to={}), "no tile with content"),
    "children of text": (edited("root", "children", to=["a"]), "children is not a list of objects"),
    "children of an object": (edited("root", "children", to={}), "children is not a list"),
    "content of text": (edited(*TREE, "content", to="a.glb"), "content 'a.glb', expected an obj"),
    "contents of text": (
        edited("root", "children", to=[{"contents": "a"}]),
        "contents is not a list of objects",
    ),
    "no name": (edited(*TREE, "content", to={}), "content: file None, expected one in its folder"),
    "name of a number": (edited(*TREE, "content", "uri", to=7), "file 7, expected one"),
    "elsewhere": (edited(*TREE, "content", "uri", to="../a.glb"), r"file '\.\./a\.glb', expected"),
    "escaped": (edited(*TREE, "content", "uri", to="%2e%2e/a.glb"), "expected one in its folder"),
    "root folder": (edited(*TREE, "content", "uri", to="/a.glb"), "expected one in its folder"),
    "other host": (edited(*TREE, "content", "uri", to="https://a/a.glb"), "in its folder"),
    "query": (edited(*TREE, "content", "uri", to="a.glb?v=1"), "expected one in its folder"),
    "b3dm": (edited(*TREE, "content", "uri", to="a.b3dm"), r"'a\.b3dm' is not read, expected"),
    "missing": (edited(*TREE, "content", "uri", to="d.glb"), r"d\.glb: No such file"),
    "twice": (edited(*TREE, "content", "uri", to="b.glb"), "belongs to several tiles"),
    "itself": (edited(*TREE, "content", "uri", to="any.json"), "belongs to several tiles"),
    "implicit": (edited(*TREE, "implicitTiling", to={}), r"implicitTiling \{\} is not read"),
    "no matrix": (edited(*TREE, "transform", to=[1]), "tile.transform is not a list of 16"),
    "stretched": (
        edited(*TREE, "transform", to=np.diag([1.0, 2, 3, 1]).ravel().tolist()),
        "stretches or shears",
    ),
    "flat": (edited(*TREE, "transform", to=[0] * 16), "stretches or shears"),
    "huge": (edited(*TREE, "transform", to=[1e300] * 16), "stretches or shears|glTF|not finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tilesets_are_refused_in_one_line(name, tmp_path):
    path = made(tmp_path, {"children": [uri("a.glb"), uri("b.glb")]})
    document = json.loads(path.read_text())
    edit, message = BAD[name]
    edit(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


# Implicit tiling

#: Tiles by level and place, those with content, and the number of levels of a subtree.
TREES: dict[str, tuple[list[tuple[int, ...]], list[tuple[int, ...]], int]] = {
    "QUADTREE": (
        [(0, 0, 0), (1, 1, 0), (1, 0, 1), (2, 3, 0), (2, 2, 1), (2, 1, 3), (3, 2, 7)],
        [(1, 1, 0), (1, 0, 1), (2, 3, 0), (3, 2, 7)],
        2,
    ),
    "OCTREE": (
        [(0, 0, 0, 0), (1, 1, 0, 1), (1, 0, 1, 0), (2, 3, 1, 2), (3, 6, 3, 5), (3, 7, 2, 4)],
        [(0, 0, 0, 0), (1, 0, 1, 0), (2, 3, 1, 2), (3, 6, 3, 5), (3, 7, 2, 4)],
        3,
    ),
}


def filled(template: str, tile: tuple[int, ...]) -> str:
    """The name of the file of a tile, as 3D Tiles describe it."""
    return template.format(**dict(zip(("level", "x", "y", "z"), tile, strict=False)))


def packed(here: list[tuple[int, ...]], start: tuple[int, ...], levels: range) -> bytes:
    """The bits of tiles in some levels of the subtree of a tile."""
    bits: list[int] = []
    axes = len(start) - 1
    for level in levels:
        for index in range(1 << axes * level):
            place = [
                sum((index >> axes * bit + axis & 1) << bit for bit in range(level))
                for axis in range(axes)
            ]
            tile = [(at << level) + own for at, own in zip(start[1:], place, strict=True)]
            bits.append((start[0] + level, *tile) in here)
    return np.packbits(bits, bitorder="little").tobytes()


def implicit(folder: Path, scheme: str, binary: bool) -> Path:
    """A tileset whose tiles with content have 1, 2, 3... Gaussians, in the order of `TREES`."""
    tiles, full, levels = TREES[scheme]
    axes = "{x}/{y}" if scheme == "QUADTREE" else "{x}/{y}/{z}"
    content, subtrees = f"c/{{level}}/{axes}.glb", f"s/{{level}}/{axes}.subtree"
    for count, tile in enumerate(full, 1):
        path = folder / filled(content, tile)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(glb(count, count))
    for tile in (tile for tile in tiles if tile[0] % levels == 0):
        inside = range(levels)
        parts = [packed(tiles, tile, inside), packed(full, tile, inside)]
        below = packed(tiles, tile, range(levels, levels + 1))
        described: dict[str, Any] = {
            "bufferViews": [], "tileAvailability": {"bitstream": 0},
            "contentAvailability": [{"bitstream": 1}],
            "childSubtreeAvailability": {"bitstream": 2} if any(below) else {"constant": 0},
        }  # fmt: skip
        data = b""
        for part in [*parts, below] if any(below) else parts:
            view = {"buffer": 0, "byteOffset": len(data), "byteLength": len(part)}
            described["bufferViews"].append(view)
            data += part + bytes(-len(part) % 8)
        path = folder / filled(subtrees, tile)
        path.parent.mkdir(parents=True, exist_ok=True)
        own = {} if binary else {"uri": f"{path.stem}.bin"}
        text = json.dumps({**described, "buffers": [{"byteLength": len(data), **own}]}).encode()
        if binary:
            text += b" " * (-len(text) % 8)
            path.write_bytes(struct.pack("<4sIQQ", b"subt", 1, len(text), len(data)) + text + data)
        else:
            path.write_bytes(text)
            path.with_suffix(".bin").write_bytes(data)
    tiling = {
        "subdivisionScheme": scheme, "subtreeLevels": levels, "availableLevels": 4,
        "subtrees": {"uri": subtrees},
    }  # fmt: skip
    root = {"refine": "REPLACE", "geometricError": 9, **uri(content), "implicitTiling": tiling}
    path = folder / TILESET
    path.write_text(json.dumps({"asset": {"version": "1.1"}, "geometricError": 9, "root": root}))
    return path


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "json"])
@pytest.mark.parametrize(
    ("scheme", "counts"),
    [("QUADTREE", [3 + 4, 1 + 4, 1 + 2]), ("OCTREE", [2 + 4 + 5, 2 + 3, 2 + 3, 1])],
)
def test_implicit_tiles_are_read_like_explicit_ones(scheme, counts, binary, tmp_path):
    """Only the tiles that exist. In the quadtree, a tile without content ends a branch."""
    path = implicit(tmp_path, scheme, binary)
    for level, count in enumerate(counts):
        assert read_scene(path, level=level).count == count
    check_file(path)
    files = {each for each in tmp_path.rglob("*") if each.is_file()}
    assert set(scene_files(path)) == files
    assert overview_of(path).file_bytes == sum(each.stat().st_size for each in files)


def test_an_implicit_tile_has_a_place_and_may_be_below_others(tmp_path):
    path = implicit(tmp_path, "OCTREE", True)
    document = json.loads(path.read_text())
    moved = document["root"] | {"transform": [*np.eye(4).ravel()[:12], 8, 0, 0, 1]}
    document["root"] = {"children": [moved, uri("c.glb")]}
    (tmp_path / "c.glb").write_bytes(glb(3, 9))
    before = read_scene(path)
    path.write_text(json.dumps(document))
    after = read_scene(path)
    np.testing.assert_allclose(
        after.positions[:, :-3], before.positions + np.array([[8], [0], [0]]), atol=1e-5
    )


def test_all_or_none_of_a_subtree_may_exist(tmp_path):
    path = implicit(tmp_path, "QUADTREE", False)
    (tmp_path / "s/0/0/0.subtree").write_text(
        '{"tileAvailability": {"constant": 1}, "contentAvailability": [{"constant": 1}],'
        ' "childSubtreeAvailability": {"constant": 0}}'
    )
    for tile in [(0, 0, 0), *((1, x, y) for x in (0, 1) for y in (0, 1))]:
        each = tmp_path / filled("c/{level}/{x}/{y}.glb", tile)
        each.parent.mkdir(parents=True, exist_ok=True)
        each.write_bytes(glb(4, 1))
    assert [read_scene(path, level=level).count for level in (0, 1)] == [16, 4]
    (tmp_path / "s/0/0/0.subtree").write_text(
        '{"tileAvailability": {"constant": 1}, "childSubtreeAvailability": {"constant": 0}}'
    )
    with pytest.raises(InvalidInput, match="no tile with content"):
        read_scene(path)


BAD_SUBTREES: dict[str, tuple[str, str]] = {
    "a list": ("[]", "subtree: not an object"),
    "no JSON": ("{", "subtree"),
    "short": ("subt", "subtree: truncated"),
    "no tiles": ("{}", "subtree: availability None"),
    "no bits": (
        '{"tileAvailability": {"bitstream": 7}, "childSubtreeAvailability": {"constant": 0}}',
        "bufferViews 7, expected one of 0",
    ),
    "few bits": (
        '{"tileAvailability": {"bitstream": 0}, "childSubtreeAvailability": {"constant": 0},'
        ' "bufferViews": [{"buffer": 0, "byteLength": 0}],'
        ' "buffers": [{"byteLength": 0, "uri": "0.bin"}]}',
        "0 bits, no bit 1",
    ),
    "missing": (
        '{"tileAvailability": {"constant": 1}, "childSubtreeAvailability": {"constant": 1}}',
        "No such file",
    ),
}


@pytest.mark.parametrize("name", BAD_SUBTREES)
def test_bad_subtrees_are_refused_in_one_line(name, tmp_path):
    path = implicit(tmp_path, "QUADTREE", False)
    text, message = BAD_SUBTREES[name]
    (tmp_path / "s/0/0/0.subtree").write_text(text)
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)
    assert "subtree" in str(caught.value)


def test_every_truncation_of_a_subtree_is_refused(tmp_path):
    path = implicit(tmp_path, "QUADTREE", True)
    subtree = tmp_path / "s/0/0/0.subtree"
    data = subtree.read_bytes()
    for end in range(len(data)):
        subtree.write_bytes(data[:end])
        with pytest.raises(InvalidInput):
            read_scene(path)


@pytest.mark.parametrize("many", [{"subtreeLevels": 60}, {"subtrees": {"uri": "s/0/0/0.subtree"}}])
def test_small_files_of_many_tiles_are_refused(many, tmp_path):
    path = implicit(tmp_path, "QUADTREE", False)
    (tmp_path / "s/0/0/0.subtree").write_text(
        '{"tileAvailability": {"constant": 1}, "childSubtreeAvailability": {"constant": 1}}'
    )
    document = json.loads(path.read_text())
    document["root"]["implicitTiling"] |= {"availableLevels": 60, **many}
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInput, match=r"more than 262,144 implicit|belongs to several tiles"):
        read_scene(path)


def test_what_is_no_tileset_is_refused(tmp_path):
    path = made(tmp_path, uri("a.glb"))
    data = path.read_bytes()
    for end in (1, len(data) // 2, len(data) - 1):
        (tmp_path / TILESET).write_bytes(data[:end])
        with pytest.raises(InvalidInput):
            read_scene(tmp_path / TILESET)
    (tmp_path / "a.glb").write_bytes((tmp_path / "a.glb").read_bytes()[:-1])
    with pytest.raises(InvalidInput, match=r"any\.json: a\.glb: glTF"):
        read_scene(path)


def test_many_large_tiles_in_small_files_are_refused(tmp_path):
    path = made(tmp_path, {"children": [uri("a.glb"), uri("b.glb")]})
    with pytest.raises(InvalidInput, match="11 Gaussians of 616 bytes; at most 300"):
        read_scene(path, max_bytes=300)


def test_coarser_levels_can_be_read(folder, tmp_path):
    for level, count in enumerate([1150, 288, 72]):
        done = convert_file(folder / TILESET, tmp_path / f"{level}.ply", level=level)
        assert abs(done.count - count) <= 4
    with pytest.raises(InvalidInput, match="level 3: the tileset has levels 0 to 2"):
        convert_file(folder / TILESET, tmp_path / "3.ply", level=3)
    with pytest.raises(InvalidInput, match=r"level: expected an \.egs or a tileset\.json"):
        convert_file(folder / "tiles/0/0.glb", tmp_path / "3.ply", level=1)
    root = {**uri("a.glb"), "children": [uri("b.glb"), {"children": [uri("c.glb")]}]}
    # A tile without content is replaced by its children.
    for level, count in enumerate([13, 13, 5]):
        assert read_scene(made(tmp_path, root), level=level).count == count


def test_levels_of_an_egs_can_be_read(tmp_path):
    write_ply(tmp_path / "a.ply", random_scene(900, 1))
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", SmallBlocks("m", lod=True, block_size=64))
    assert convert_file(tmp_path / "a.egs", tmp_path / "b.ply", level=1).count == 225


def test_verify_reads_all_levels(copy):
    check_file(copy / TILESET)
    (copy / "tiles/1/0.glb").write_bytes(b"glTF")
    assert read_scene(copy / TILESET).count == 1150
    with pytest.raises(InvalidInput, match=r"tiles/1/0\.glb"):
        check_file(copy / TILESET)


def archived(folder: Path, path: Path, **others: str) -> Path:
    """A zip of the files of a folder, and of others by name."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for each in sorted(e for e in folder.rglob("*") if e.is_file()):
            archive.write(each, each.relative_to(folder))
        for name, text in others.items():
            archive.writestr(name, text)
    return path


@pytest.mark.parametrize("name", ["a.3tz", "a.3dtiles.zip"])
def test_an_archive_is_read_like_its_files(name, folder, copy, tmp_path, monkeypatch):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    path = archived(copy, tmp_path / name, **{"@3dtilesIndex1@": "index"})
    assert_same_floats(read_scene(path), read_scene(folder / TILESET))
    told = overview_of(path)
    assert (told.format, told.count, told.file_bytes) == ("3d tiles", 1150, path.stat().st_size)
    assert scene_files(path) == [path]
    assert abs(convert_file(path, tmp_path / "1.ply", level=1).count - 288) <= 4
    check_file(path)
    (copy / "tiles/1/0.glb").unlink()
    with pytest.raises(InvalidInput) as caught:
        check_file(archived(copy, path))
    assert str(caught.value) == f"{path}: tiles/1/0.glb: No such file or directory"
    with pytest.raises(InvalidInput, match=r"zip: file '\.\./a', expected one in its folder"):
        read_scene(archived(copy, path, **{"../a": "elsewhere"}))
    with pytest.raises(InvalidInput, match=r"zip entry 'tiles/0/0\.glb': "):
        read_scene(archived(copy, path, **{"tiles/0": "a folder elsewhere"}))
    assert [*(tmp_path / "temporary").iterdir()] == []


# CesiumJS


@pytest.mark.slow
def test_the_validator_of_3d_tiles_finds_nothing_but_unknown_attributes(tmp_path):
    program = PACKAGES / "3d-tiles-validator/build/main.js"
    if not (NODE and program.is_file()):
        pytest.skip("3d-tiles-validator: not installed ('make peers')")
    tiled(tmp_path, random_scene(500, 1), at=AT)
    command = [NODE, str(program), "--tilesetFile", str(tmp_path / TILESET)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)

    def found(issues: list[dict[str, Any]]) -> Iterator[str]:
        for issue in issues:
            if "causes" in issue:
                yield from found(issue["causes"])
            elif issue["severity"] != "INFO":
                yield issue["message"]

    issues = json.loads(ended.stdout[ended.stdout.index("{") :]).get("issues", [])
    assert {*found(issues)} <= {"Invalid attribute name."}


def shown_by_cesium(folder: Path, views: list[Camera], **first: float) -> list[list[list[str]]]:
    """Have CesiumJS draw the tileset of a folder, which is at `AT`; see `cesium_view.mjs`.

    Returns the tiles drawn in each view, in turn. `first` are further values of the first view.
    """
    if not (NODE and CHROMIUM and (PACKAGES / "cesium").is_dir()):
        pytest.skip("CesiumJS: not installed ('make peers')")
    # Right, up, back of the scene are east, up, south.
    turn = frame_at(AT)[:3, :3] @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    described: list[dict[str, Any]] = [
        {
            "width": view.width, "height": view.height, "focal": view.fx, "near": 0.1, "far": 1000,
            "position": (turn @ view.position + frame_at(AT)[:3, 3]).tolist(),
            "direction": (turn @ view.rotation[2]).tolist(),
            "up": (turn @ -view.rotation[1]).tolist(),
        }
        for view in views
    ]  # fmt: skip
    described[0] |= first
    (folder / "views.json").write_text(json.dumps(described))
    script = Path(__file__).with_name("cesium_view.mjs")
    command = [NODE, script, PACKAGES, CHROMIUM, folder / TILESET, folder / "views.json", folder]
    subprocess.run([*map(str, command)], check=True, timeout=400)
    return [
        [[url.partition("/files/")[2] for url in tiles] for tiles in of_view if tiles]
        for of_view in json.loads((folder / "drawn.json").read_text())
    ]


@pytest.mark.slow
def test_cesium_shows_coarse_tiles_first_and_then_the_same_picture(tmp_path):
    scene = generate(4000, 3, seed=5)
    # Without background: a viewer inside the box of a tile shows it in full detail.
    scene = scene.take(np.abs(scene.positions).max(axis=0) < 1.5)
    document = tiled(tmp_path, scene, most=1000, at=AT)
    errors = [document["geometricError"], document["root"]["geometricError"]]
    views = [replace(each, fx=each.fx, fy=each.fx) for each in cameras(2, 480, 320)]
    # Between the errors of the root and of no tile, a unit away.
    coarse = views[0].fx * math.sqrt(math.prod(errors))
    names, *_, last = shown_by_cesium(tmp_path, views, coarse=coarse)
    assert names[0] == ["tiles/1/0.glb"]
    assert names[-1] == last[-1] == [f"tiles/0/{k}.glb" for k in range(3)]
    first, *fine = (
        decibels(seen(tmp_path / f"{name}.png"), drawn(scene, view))
        for name, view in zip(("first", 0, 1), (views[0], *views), strict=True)
    )
    assert min(fine) > 38
    assert first < min(fine)


def wanted_tiles(tile: dict[str, Any], view: Camera) -> Iterator[str]:
    """The coarsest tiles with an error of at most 16 pixels in a view."""
    low, high = corners(tile)
    # RDF to the axes of glTF in tiles: right, up, back.
    eye = view.position * [1, -1, -1]
    distance = np.linalg.norm(np.maximum(np.maximum(low - eye, eye - high), 0))
    if tile["geometricError"] * view.fx <= 16 * distance:
        yield tile["content"]["uri"]
    else:
        for child in tile["children"]:
            yield from wanted_tiles(child, view)


@pytest.mark.slow
def test_cesium_draws_fine_tiles_when_near_and_coarse_ones_from_afar(tmp_path):
    """At the error that it accepts by default, 16 pixels."""
    scene = generate(6000, 1, seed=5)
    scene = scene.take(np.abs(scene.positions).max(axis=0) < 1.5)
    root = tiled(tmp_path, scene, most=300, at=AT)["root"]
    views = [facing((1, -0.5, -0.8), distance=d, side=320) for d in (100, 20, 8)]
    expected = [sorted(wanted_tiles(root, view)) for view in views]
    levels = [{name.split("/")[1] for name in names} for names in expected]
    assert levels == [{"2"}, {"0", "1"}, {"0"}]
    shown = shown_by_cesium(tmp_path, views)
    assert [tiles[-1] for tiles in shown] == expected
    for number, view in enumerate(views):
        assert decibels(seen(tmp_path / f"{number}.png"), drawn(scene, view)) > 43


def test_a_loss_by_the_limits_of_a_format_is_a_warning(tmp_path, caplog):
    """An `.spz` has no standard deviations above 365; tiles in millimetres need larger ones."""
    scene = generate(2000, 0, seed=0)
    large = replace(
        scene,
        positions=scene.positions * np.float32(1e5),
        log_scale=scene.log_scale + np.float32(np.log(1e5)),
    )
    write_ply(tmp_path / "a.ply", large)
    report = convert_file([tmp_path / "a.ply"], tmp_path / "tiles" / "tileset.json")
    assert report.rendered.loss > 2 * report.rendered.aimed
    assert "rendered views lose" in caplog.text
