"""Other programs read our files, and get the same Gaussians as our reader."""

from __future__ import annotations

import inspect
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from orbits import cameras
from other_programs import PACKAGES, PROGRAMS, check, stored_numbers
from scenes import random_scene

import gs_codec.formats
from gs_codec.bench.peers import find_splat_transform
from gs_codec.config import Config
from gs_codec.edit.actions import Action
from gs_codec.errors import MissingTool
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.packed_values import unit_quaternions
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.sog.writer import pack_sog
from gs_codec.merging.moments import covariances_of
from gs_codec.plan import Plan, Steps
from gs_codec.scene import GROUPS, Scene
from samples.generate import generate

pytestmark = pytest.mark.slow

DOCUMENT = Path(gs_codec.formats.__file__).with_name("FORMATS.md").read_text()

FORMATS = (
    "sog",
    "json",
    "compressed.ply",
    "splat",
    "rad",
    "glb",
    "gltf",
    "spz.glb",
    "spz",
    "v4.spz",
)

CONFIGS = {
    "v4.spz": Config(format="spz", spz_version=4),
    "spz.glb": Config(format="glb", gltf_compression="spz"),
}


def wide(scene: Scene) -> Scene:
    """The scene with many values outside the range of formats."""
    rng = np.random.default_rng(3)

    def spread(plane: np.ndarray, by: float) -> np.ndarray:
        factor = np.where(rng.random(plane.shape) < 0.1, by, 1)
        return (plane * factor).astype(np.float32)

    return replace(
        scene,
        positions=spread(scene.positions, 1e3),
        f_dc=spread(scene.f_dc, 9),
        f_rest=spread(scene.f_rest, 30),
        opacity=spread(scene.opacity, 9),
        log_scale=spread(scene.log_scale, 4),
    )


def scenes() -> dict[str, Scene]:
    each = {f"degree{degree}": random_scene(700, degree, seed=degree) for degree in range(4)}
    one = random_scene(1, 3, seed=9)
    return {**each, "one": one, "wide": wide(each["degree3"]), "guided": generate(900, 3, seed=5)}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, list[Path]]:
    """Each scene in each format, by format."""
    folder = tmp_path_factory.mktemp("written")
    made: dict[str, list[Path]] = {name: [] for name in FORMATS}
    for name, scene in scenes().items():
        source = folder / f"{name}.ply"
        write_ply(source, scene)
        for form in FORMATS:
            target = folder / name / "meta.json" if form == "json" else folder / f"{name}.{form}"
            target.parent.mkdir(exist_ok=True)
            config = CONFIGS.get(form, Config())
            if name == "guided":
                encode_file(source, target, config, Plan(Steps(), cameras(24)))
            else:
                convert_file(source, target, config)
            made[form].append(target)
    return made


CASES = [
    (program, form)
    for program, of in PROGRAMS.items()
    for form in FORMATS
    if form in of.formats.split()
]


@pytest.mark.parametrize(("program", "form"), CASES)
def test_programs_agree_with_our_reader(program, form, request):
    of = PROGRAMS[program]
    try:
        of.read([])
    except (ModuleNotFoundError, MissingTool) as error:
        pytest.skip(f"{program}: not installed ('make peers'), {error}")
    paths = request.getfixturevalue("files")[form]
    for path, theirs in zip(paths, of.read(paths), strict=True):
        print(path)  # shown on failure
        check(theirs, stored_numbers(path), form, of.exact)


#: What CesiumJS needs, but the validator advises against: a matrix, and data of an extension.
NEEDED = ("NODE_MATRIX_DEFAULT", "UNUSED_OBJECT")


@pytest.mark.parametrize("form", ["glb", "gltf", "spz.glb"])
def test_the_validator_of_gltf_finds_nothing_but_an_unknown_extension(form, request):
    node = shutil.which("node")
    if not (node and (PACKAGES / "gltf-validator").is_dir()):
        pytest.skip("gltf-validator: not installed ('make peers')")
    code = (
        "const [packages, path] = process.argv.slice(1);"
        "require(packages + '/gltf-validator').validateBytes(require('fs').readFileSync(path))"
        ".then((report) => console.log(JSON.stringify(report.issues)));"
    )
    for path in request.getfixturevalue("files")[form]:
        command = [node, "-e", code, str(PACKAGES), str(path)]
        ended = subprocess.run(command, check=True, capture_output=True)
        issues = json.loads(ended.stdout)
        assert not issues["truncated"]
        for issue in issues["messages"]:
            if form == "spz.glb" and issue["code"] in NEEDED:
                continue
            assert "KHR_gaussian_splatting" in issue["message"] + issue["pointer"], issue


#: Actions as typed for splat-transform, which first converts a PLY to left, up, forward, and for
#: `convert`, which does not: x and y have opposite signs.
SAME_JOBS = {
    "crop box": ("--filter-box=-0.5,-1,-1,1,0.7,0.5", "--crop-box=-1,-0.7,-1,0.5,1,0.5"),
    "crop sphere": ("--filter-sphere=0.1,0.2,0,1", "--crop-sphere=-0.1,-0.2,0,1"),
    "translate": ("--translate=1,-2,0.5", "--translate=-1,2,0.5"),
    "rotate": ("--rotate=30,-50,110", "--rotate=-30,50,110"),
    "scale": ("--scale=2.5", "--scale=2.5"),
    "all": (
        "--scale=2 --rotate=10,20,30 --translate=0.1,0,0 --filter-box=-2,-2,-2,2,2,1",
        "--scale=2 --rotate=-10,-20,30 --translate=-0.1,0,0 --crop-box=-2,-2,-2,2,2,1",
    ),
}


@pytest.fixture(scope="module")
def splat_transform() -> str:
    try:
        return find_splat_transform()[0]
    except MissingTool as error:
        pytest.skip(f"splat-transform: not installed ('make peers'), {error}")


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("job", [*SAME_JOBS, "merge"])
def test_splat_transform_does_the_same_job(splat_transform, job, degree, tmp_path):
    """Equal, up to float32 rounding."""
    names = [tmp_path / f"{i}.ply" for i in range(2)]
    for i, path in enumerate(names):
        write_ply(path, random_scene(900 - 400 * i, degree, seed=degree + 9 * i))
    inputs = [str(path) for path in (names if job == "merge" else names[:1])]
    theirs, ours = SAME_JOBS.get(job, ("", ""))
    command = [splat_transform, "--quiet", *inputs, *theirs.split(), str(tmp_path / "theirs.ply")]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    actions = [Action(*each.removeprefix("--").split("=", 1)) for each in ours.split()]
    convert_file(inputs, tmp_path / "ours.ply", actions=actions)
    expected, found = read_ply(tmp_path / "theirs.ply"), read_ply(tmp_path / "ours.ply")
    assert expected.count == found.count < 1401
    for group in GROUPS:
        one, other = getattr(expected, group), getattr(found, group)
        if group == "rot":
            # It writes unit quaternions; a quaternion and its negative are the same rotation.
            one, other = unit_quaternions(one), unit_quaternions(other)
            other = other * np.copysign(1, (one * other).sum(axis=0))
        np.testing.assert_allclose(other, one, rtol=2e-6, atol=4e-6, err_msg=group)


def test_the_documented_programs_are_those_that_read_our_files():
    """The second column of the table of programs."""
    table = DOCUMENT.partition("## Programs\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| `.")]
    told = {row[0].split("`")[1]: set(row[1].strip().split(", ")) - {""} for row in rows[::-1]}
    names = {"playcanvas": "PlayCanvas", "spark": "Spark"}
    for form in ("compressed.ply", "splat", "spz", "sog", "glb", "rad"):
        readers = {names.get(n, n) for n, p in PROGRAMS.items() if form in p.formats.split()}
        assert told[f".{form}"] == readers, form


def test_our_compression_has_the_methods_of_gsplats_own():
    own = pytest.importorskip("gsplat.compression", exc_type=ImportError).PngCompression
    for method in ("compress", "decompress"):
        there, here = (
            list(inspect.signature(getattr(kind, method)).parameters)
            for kind in (own, gs_codec.Compression)
        )
        assert here == there


@pytest.mark.parametrize("name", ["a.lcc", "a.lcc2"])
def test_splat_transform_reads_the_same_from_scenes_of_xgrids(splat_transform, name, tmp_path):
    """Without the environment, which comes last."""
    parts = {f"{n}.sog": pack_sog(random_scene(40, 1, seed=n))[0] for n in range(4)}
    files = {**foreign.lcc_files("Quality")[0], **parts, **foreign.lcc2_files([*parts])}
    for each, data in files.items():
        (tmp_path / each).write_bytes(data)
    source, target = tmp_path / name, tmp_path / "theirs.ply"
    command = [splat_transform, "--quiet", "-L", "0", str(source), str(target)]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    expected = read_ply(target)
    found = read_scene(source).between(0, expected.count)
    assert expected.count == (7 if name == "a.lcc" else 80)
    for group in ("positions", "f_dc", "f_rest"):
        np.testing.assert_allclose(getattr(found, group), getattr(expected, group), atol=1e-6)
    # It turns ellipsoids; we exchange their axes.
    covariances = [covariances_of(scene)[0] for scene in (found, expected)]
    np.testing.assert_allclose(*covariances, rtol=1e-5, atol=1e-6)
