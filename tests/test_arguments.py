"""Public functions and classes: invalid arguments give one line of GsCodecError."""

from __future__ import annotations

import inspect
import os
from dataclasses import is_dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene

import gs_codec
import gs_codec.edit
import viewer
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply

#: Values that no argument named `source`, `path` or `config` accepts.
WRONG = (None, 5, 1.5, ["a"], {"a": 1}, object(), True)

#: Valid arguments besides the wrong one, by parameter name.
GOOD = {
    "path": "out.ply", "target": "out.egs", "cameras": [],
    "plan": gs_codec.Plan(cameras="none.json"),
    "first": "a.ply", "second": "a.ply", "source": "a.ply", "name": "entropygs", "depth": 3,
    "low": (0, 0, 0), "high": (1, 1, 1), "centre": (0, 0, 0), "radius": 1.0, "condition": "x>0",
    "sh_degree": 1, "offset": (0, 0, 0), "angles": (0, 0, 0), "factor": 2.0, "matrix": np.eye(4),
    "number": 5, "tensors": {}, "splats": None, "clouds": [],
}  # fmt: skip

FUNCTIONS = {
    name: each
    for module in (gs_codec, gs_codec.edit)
    for name in module.__all__
    if inspect.isfunction(each := getattr(module, name))
}


@pytest.fixture(scope="module", autouse=True)
def scenes(tmp_path_factory):
    before = Path.cwd()
    os.chdir(tmp_path_factory.mktemp("arguments"))
    write_ply("a.ply", random_scene(60, 1, seed=7))
    encode_file("a.ply", "a.egs", "paper-m")
    yield
    os.chdir(before)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_wrong_types_are_one_line(name):
    function, refused = FUNCTIONS[name], 0
    parameters = inspect.signature(function).parameters
    needed = {n: GOOD.get(n) for n, p in parameters.items() if p.default is p.empty}
    if "scene" in needed or "cloud" in needed:
        needed["scene" if "scene" in needed else "cloud"] = gs_codec.read("a.ply")
    if name.startswith("prepare") or name.endswith("distributed"):
        needed["source"] = "none.ply"  # valid input would take seconds
    if name == "render":
        needed["cameras"] = "none.json"
    for wrong in parameters:
        for value in WRONG:
            try:
                function(**needed | {wrong: value})
            except GsCodecError as error:
                refused += "\n" not in str(error)
    assert refused >= 4 * len(parameters)


DRAWN = inspect.signature(viewer.draw).parameters.keys() - {"scenes", "pruned", "up", "cameras"}


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (viewer.draw, "draw: 0 scenes, expected one or two"),
        (lambda: viewer.draw(5), "scene: int, expected an open3d.t.geometry.PointCloud"),
        (lambda: viewer.draw("a.ply", None), "scene: None, expected an open3d"),
        (lambda: viewer.draw("a.ply", layers="splats"), "layers: str 'splats', expected Sequence"),
        (lambda: viewer.draw("a.ply", pruned=5), "pruned: int 5, expected str or Path"),
        (lambda: viewer.draw("a.ply", up=5), "up: int 5, expected str"),
        (lambda: viewer.draw("a.ply", cameras=5), "cameras: int 5, expected str or Path or "),
        *((partial(viewer.draw, "a.ply", **{n: object()}), f"{n}: object ") for n in sorted(DRAWN)),
        (lambda: viewer.attach(5), "visualizer: int, expected an open3d.visualization.O3DVis"),
    ],
)
def test_the_viewer_checks_types_before_it_opens_a_window(call, text, monkeypatch):
    monkeypatch.setattr("viewer.plugin.find_device", lambda: pytest.fail("looks for a display"))
    with pytest.raises(GsCodecError) as error:
        call()
    assert str(error.value).startswith(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "each",
    [gs_codec.Config, gs_codec.RateTarget, gs_codec.Plan, gs_codec.Steps, gs_codec.Part,
     gs_codec.Camera, gs_codec.Lens, gs_codec.edit.Action],
)  # fmt: skip
def test_wrong_types_of_fields_are_one_line(each):
    assert is_dataclass(each)
    camera = {"name": "a", "width": 8, "height": 8, "fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 4.0}
    good = {
        gs_codec.Camera: camera | {"rotation": np.eye(3), "position": np.zeros(3)},
        gs_codec.edit.Action: {"name": "scale", "text": "2"},
        gs_codec.Lens: {n: v for n, v in camera.items() if n != "name"}
        | {"fisheye": True, "coefficients": (0.0,) * 4},
    }
    needed = good.get(each, {})
    # Cameras are validated together with the scene.
    for name in inspect.signature(each).parameters.keys() - {"cameras"}:
        for value in (object(), {5: object()}, [object()]):
            with pytest.raises(GsCodecError) as error:
                each(**needed | {name: value})
            assert name.removesuffix("s") in str(error.value)


def test_profiles_are_accepted_by_name():
    cloud = gs_codec.read("a.ply")
    data = gs_codec.encode(cloud, "s")
    assert data == gs_codec.encode(cloud, gs_codec.Config("s")) == gs_codec.encode(cloud, "low")
    assert gs_codec.encode(cloud, config="l") != data
    gs_codec.write("named.egs", cloud, "s")
    assert Path("named.egs").read_bytes() == data
    assert gs_codec.encode_file("a.ply", "file.egs", "s").count == 60
    assert gs_codec.inspect("file.egs").profile == "s"
    gs_codec.convert_file("a.ply", "converted.egs", "l")
    assert gs_codec.inspect(Path("converted.egs")).profile == "l"
    with pytest.raises(InvalidInput, match="profile 'best': expected one of l, m, s"):
        gs_codec.encode(cloud, "best")


def test_paths_are_accepted_as_strings():
    assert (
        gs_codec.encode("a.ply", "s") == Path("file2.egs").read_bytes()
        if (gs_codec.encode_file("a.ply", "file2.egs", "s"))
        else False
    )
    by_path = gs_codec.decode("a.egs")
    for data in (Path("a.egs").read_bytes(), bytearray(Path("a.egs").read_bytes())):
        for name in ("positions", "f_rest", "rot"):
            expected = by_path.point[name].numpy()
            np.testing.assert_array_equal(gs_codec.decode(data).point[name].numpy(), expected)
    assert len(gs_codec.decode(Path("a.egs"), gs_codec.Part(sh_degree=0)).point.f_rest[0]) == 0
    data, report = gs_codec.encode("a.ply", rate={"size": 4000.0})
    assert len(data) == report.file_bytes <= 4000
    with pytest.raises(InvalidInput, match=r"none\.egs: No such file"):
        gs_codec.decode("none.egs")
    with pytest.raises(GsCodecError, match=r"a.ply: "):
        gs_codec.decode("a.ply")


def test_integers_may_be_floats():
    cloud = gs_codec.read("a.ply")
    assert len(gs_codec.edit.decimate(cloud, 20.0).point.positions) == 20
    assert gs_codec.edit.limit_sh_degree(cloud, 0.0).point.f_rest.shape[1] == 0
    [(_, drawn), *_] = gs_codec.render(cloud, width=np.float32(16))
    assert drawn.alpha.shape[1] == 16
    gs_codec.encode_sequence([cloud, cloud], "two.egs", fps=np.float32(25))
    assert len(list(gs_codec.decode_sequence("two.egs", 1.0, 2.0))) == 1


def test_what_lists_contain_is_checked():
    gs_codec.convert_file("a.ply", "some.ply", chosen=[True] * 10 + [False] * 50)
    assert len(gs_codec.read("some.ply").point.positions) == 10
    with pytest.raises(InvalidInput, match="source: no scenes, expected at least one"):
        gs_codec.convert_file([], "none.ply")
    for fps in (0, float("nan"), float("inf")):
        with pytest.raises(InvalidInput, match=r"fps: .*, expected more than 0"):
            gs_codec.encode_sequence([gs_codec.read("a.ply")], "one.egs", fps=fps)
    with pytest.raises(InvalidInput, match="source: list_iterator, expected a path or list"):
        gs_codec.encode_sequence(iter([gs_codec.read("a.ply")]), "one.egs")


def test_iterators_are_as_good_as_lists():
    half = gs_codec.edit.Action("keep", "50%")
    assert gs_codec.convert_file("a.ply", "half.ply", actions=iter([half])).count == 30
    cloud = gs_codec.read("a.ply")
    turned = [gs_codec.edit.rotate(cloud, each) for each in ([1, 2, 3], iter([1, 2, 3]))]
    first, second = (each.point.positions.numpy() for each in turned)
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: gs_codec.encode(["a.ply"]), "scene: list, expected an open3d.t.geometry.Point"),
        (lambda: gs_codec.decode(5), "source: int 5, expected bytes or bytearray or memoryview"),
        (lambda: gs_codec.read(None), "path: None, expected str or Path"),
        (lambda: gs_codec.write(gs_codec.read("a.ply"), "b.ply"), "path: PointCloud "),
        (lambda: gs_codec.encode_file("a.ply", "b.egs", 5), "config: int 5, expected Config or s"),
        (lambda: gs_codec.encode("a.ply", threads=5), None),
        (lambda: gs_codec.Config(threads="2"), "threads: str '2', expected int"),
        (lambda: gs_codec.RateTarget(size="5MB"), "size: str '5MB', expected int"),
        (lambda: gs_codec.read("a\0b.ply"), "path: 'a\\x00b.ply', expected a possible path"),
        (lambda: gs_codec.inspect("a\ud800b.ply"), "source: 'a\\ud800b.ply', expected a possible"),
        (lambda: gs_codec.convert_file(["a.ply", Path("\0")], "c.egs"), "source: '\\x00',"),
        (lambda: gs_codec.Plan(cameras="\0"), "cameras: '\\x00', expected a possible path"),
        (lambda: gs_codec.Plan(cameras=iter(())), "cameras: tuple_iterator, expected a list or t"),
        (lambda: gs_codec.encode_file("a.ply", "c.egs", max_memory=10**400), "max_memory: int 1"),
        (lambda: gs_codec.edit.scale(gs_codec.read("a.ply"), 10**400), "factor: int 1000"),
        (lambda: gs_codec.Part(level=Fraction(10**400)), "level: Fraction "),
        (lambda: gs_codec.from_tensors({"means": [[1.0], [1.0, 2.0]]}), "tensor: 'setting an"),
    ],
)
def test_error_messages(call, text):
    if text is None:  # Python itself reports an unknown parameter
        with pytest.raises(TypeError, match="threads"):
            call()
        return
    with pytest.raises(InvalidInput) as error:
        call()
    assert str(error.value).startswith(text)


def test_nothing_is_overwritten_by_default():
    cloud, cameras = gs_codec.read("a.ply"), gs_codec.render("a.ply", width=24).cameras
    plan = gs_codec.Plan(gs_codec.Steps(prune=20), cameras[:2])
    calls = {
        "write": lambda path, **o: gs_codec.write(path, cloud, **o),
        "encode_file": lambda path, **o: gs_codec.encode_file("a.ply", path, **o),
        "encode_sequence": lambda path, **o: gs_codec.encode_sequence([cloud], path, **o),
        "decode_file": lambda path, **o: gs_codec.decode_file("a.egs", path, **o),
        "convert_file": lambda path, **o: gs_codec.convert_file("a.ply", path, **o),
        "prepare_file": lambda path, **o: gs_codec.prepare_file("a.ply", path, plan, **o),
        "write_cameras": lambda path, **o: gs_codec.write_cameras(path, cameras, **o),
        "encode_distributed": None, "decode_distributed": None,
    }  # fmt: skip
    listed = (getattr(gs_codec, name) for name in gs_codec.__all__)
    writing = [
        each for each in listed
        if inspect.isfunction(each) and "overwrite" in inspect.signature(each).parameters
    ]  # fmt: skip
    assert {each.__name__ for each in writing} - {"compare"} == set(calls)
    for each in writing:
        assert inspect.signature(each).parameters["overwrite"].default is False
    for name, call in calls.items():
        coded = name in ("encode_file", "encode_sequence")
        path = Path(f"{name}.egs" if coded else f"{name}.ply")
        if call is None:
            continue
        path.write_bytes(b"before")
        with pytest.raises(InvalidInput, match=f"{path}: already exists; choose another name"):
            call(path)
        assert path.read_bytes() == b"before"
        call(path, overwrite=True)
        assert path.read_bytes() != b"before"
