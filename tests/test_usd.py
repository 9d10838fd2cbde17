"""OpenUSD: writing, and everything that its reader may encounter."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from appearance import assert_held_exactly, assert_seen_alike
from damage import changed
from scenes import assert_same_bits, random_scene

from gs_codec.errors import InvalidInput, MissingTool, ToolFailed
from gs_codec.files.scenes import read_scene, stated_bytes
from gs_codec.format_table import USD
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.registry import open_scene
from gs_codec.formats.usd import scene as usd
from gs_codec.formats.usd.scene import pack_usd
from gs_codec.scene import ANTIALIASED, SH_COEFFICIENTS, Scene
from gs_codec.sequences.frame_sources import open_frames

pytest.importorskip("pxr", reason="the extra 'usd' is not installed")

HEAD = '#usda 1.0\n(\n    upAxis = "Y"\n)\n'
SPLATS = """
def ParticleField3DGaussianSplat "A"
{
    point3f[] positions = [(1, 2, 3), (4, 5, 6)]
    quatf[] orientations = [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)]
    float3[] scales = [(1, 2, 4), (8, 16, 32)]
    float[] opacities = [0.5, 0.25]
    uniform int radiance:sphericalHarmonicsDegree = 1
    float3[] radiance:sphericalHarmonicsCoefficients = [
        (0, 1, 2), (3, 4, 5), (6, 7, 8), (9, 10, 11),
        (20, 21, 22), (23, 24, 25), (26, 27, 28), (29, 30, 31)]
}
"""


def read(tmp_path: Path, text: str, name: str = "a.usda") -> Scene:
    path = tmp_path / name
    path.write_text(text)
    return read_scene(path, coordinates=None)


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


# Writing


@pytest.mark.one_in(4)
@pytest.mark.parametrize("suffix", USD.written)
@pytest.mark.parametrize(("count", "degree"), [(0, 3), (1, 0), (200, 1), (200, 2), (200, 3)])
def test_written_usd_round_trips(count, degree, suffix, tmp_path):
    scene = random_scene(count, degree, seed=degree)
    path = written(tmp_path / f"a{suffix}", pack_usd(scene, suffix)[0])
    assert path.read_bytes() == pack_usd(scene, suffix)[0]
    back = read_scene(path)
    assert (back.count, back.sh_degree, back.coordinates) == (count, degree, "RDF")
    assert_held_exactly(back, scene)


def test_a_scene_of_megabytes_is_read_without_a_limit(tmp_path):
    """What an encoder wrote is read like this, to measure its loss; a limit of bytes wrapped."""
    path = written(tmp_path / "a.usdc", pack_usd(random_scene(20_000, 3), ".usdc")[0])
    with open_scene(path) as file:
        assert file.scene(max_bytes=sys.maxsize).count == 20_000


@pytest.mark.parametrize("degree", range(4))
def test_attributes_follow_the_schema(degree, tmp_path):
    from pxr import Usd, UsdGeom, UsdVol

    scene = random_scene(7, degree, seed=1)
    path = written(tmp_path / "a.usdc", pack_usd(scene, ".usdc")[0])
    stage = Usd.Stage.Open(str(path))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1)
    splats = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    turned = turn_axes(scene, "RUB")
    np.testing.assert_array_equal(splats.GetPositionsAttr().Get(), turned.positions.T)
    np.testing.assert_array_equal(turned.positions[1:], -scene.positions[1:])
    for quaternion, rot in zip(splats.GetOrientationsAttr().Get(), turned.rot.T, strict=True):
        found = [quaternion.GetReal(), *quaternion.GetImaginary()]
        np.testing.assert_allclose(found, rot / np.linalg.norm(rot), atol=1e-6)
    np.testing.assert_allclose(splats.GetScalesAttr().Get(), np.exp(scene.log_scale.T), rtol=1e-6)
    share = 1 / (1 + np.exp(-scene.opacity[0].astype(np.float64)))
    np.testing.assert_allclose(splats.GetOpacitiesAttr().Get(), share, rtol=1e-6)
    assert splats.GetRadianceSphericalHarmonicsDegreeAttr().Get() == degree
    attribute = splats.GetRadianceSphericalHarmonicsCoefficientsAttr()
    count = 1 + SH_COEFFICIENTS[degree]
    assert UsdGeom.Primvar(attribute).GetElementSize() == count
    sh = np.array(attribute.Get()).reshape(7, count, 3)
    np.testing.assert_array_equal(sh[:, 0], turned.f_dc.T)
    for k in range(1, count):
        rows = turned.f_rest[[k - 1 + colour * (count - 1) for colour in range(3)]]
        np.testing.assert_array_equal(sh[:, k], rows.T)
    low, high = np.array(splats.GetExtentAttr().Get())
    reach = 3 * np.exp(scene.log_scale.max(axis=0))
    np.testing.assert_allclose(low, (turned.positions - reach).min(axis=1), rtol=1e-6)
    np.testing.assert_allclose(high, (turned.positions + reach).max(axis=1), rtol=1e-6)


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_other_programs_find_nothing_wrong(suffix, tmp_path):
    from pxr import Usd, UsdValidation

    path = written(tmp_path / f"a{suffix}", pack_usd(random_scene(9, 2), suffix)[0])
    stage = Usd.Stage.Open(str(path))
    registry = UsdValidation.ValidationRegistry()
    errors = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage)
    assert [error.GetMessage() for error in errors] == []


def test_files_of_a_usdz_are_stored_at_multiples_of_64_bytes():
    data = pack_usd(random_scene(3, 1), ".usdz")[0]
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        [entry] = archive.infolist()
        assert archive.read(entry) == pack_usd(random_scene(3, 1), ".usdc")[0]
    assert (entry.filename, entry.compress_type) == ("scene.usdc", zipfile.ZIP_STORED)
    assert data.index(b"PXR-USDC") % 64 == 0


def test_losses_of_usd_are_reported_or_refused():
    scene = random_scene(4, 0)
    lost = pack_usd(replace(scene, comments=(ANTIALIASED, "one")), ".usd")[1]
    assert lost[1:] == ("left out: antialias flag; comments (1)",)
    large = replace(scene, log_scale=np.full((3, 4), 89, np.float32))
    with pytest.raises(InvalidInput, match=r"log-scale 89\.0, USD holds up to 88"):
        pack_usd(large, ".usd")
    scene.positions[0, 1] = np.nan
    with pytest.raises(InvalidInput, match="not finite, which USD cannot store"):
        pack_usd(scene, ".usd")


def test_an_openusd_without_gaussians_is_reported(monkeypatch):
    monkeypatch.delattr("pxr.UsdVol.ParticleField3DGaussianSplat")
    with pytest.raises(MissingTool, match=r"without Gaussians\); pip install 'gs-codec\[usd\]'"):
        pack_usd(random_scene(2, 0), ".usd")


@pytest.mark.thorough
def test_other_processes_write_the_same_bytes(tmp_path):
    code = (
        "import sys; from scenes import random_scene\n"
        "from gs_codec.formats.usd.scene import pack_usd\n"
        "sys.stdout.buffer.write(pack_usd(random_scene(50, 3), '.usdc')[0])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, cwd=Path(__file__).parent
    )
    assert done.stdout == pack_usd(random_scene(50, 3), ".usdc")[0]


# Reading


@pytest.mark.thorough
def test_a_stage_of_text_is_read(tmp_path):
    scene = read(tmp_path, HEAD + SPLATS)
    assert (scene.count, scene.sh_degree, scene.coordinates) == (2, 1, "RUB")
    np.testing.assert_array_equal(scene.positions.T, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(scene.rot.T, [[1, 0, 0, 0], [0.5] * 4])
    np.testing.assert_allclose(np.exp2(scene.log_scale / np.log(2)).T, [[1, 2, 4], [8, 16, 32]])
    np.testing.assert_allclose(scene.opacity[0], [0, -np.log(3)], rtol=1e-6)
    np.testing.assert_array_equal(scene.f_dc.T, [[0, 1, 2], [20, 21, 22]])
    first = [3, 6, 9, 4, 7, 10, 5, 8, 11]
    np.testing.assert_array_equal(scene.f_rest.T, [first, np.add(first, 20)])
    assert stated_bytes(tmp_path / "a.usda") == scene.float_bytes


@pytest.mark.one_in(4)
@pytest.mark.parametrize("suffix", [".usdz", ".sog", ".usd", ""])
def test_formats_are_recognised_by_content(suffix, tmp_path):
    kind = ".usdz" if suffix in (".usdz", ".sog") else ".usdc"
    path = written(tmp_path / f"a{suffix}", pack_usd(random_scene(3, 1), kind)[0])
    assert read_scene(path).count == 3


@pytest.mark.thorough
def test_halves_are_read_if_there_are_no_floats(tmp_path):
    halves = SPLATS.replace("point3f[] positions", "point3h[] positionsh")
    halves = halves.replace("quatf[] orientations", "quath[] orientationsh")
    halves = halves.replace("float3[] scales", "half3[] scalesh")
    halves = halves.replace("float[] opacities", "half[] opacitiesh")
    halves = halves.replace(
        "float3[] radiance:sphericalHarmonicsCoefficients",
        "half3[] radiance:sphericalHarmonicsCoefficientsh",
    )
    assert halves.count("h = ") == 5
    scene = read(tmp_path, HEAD + SPLATS)
    assert_same_bits(read(tmp_path, HEAD + halves), scene)
    both = halves.replace("point3h", "point3f[] positions = [(7, 7, 7), (8, 8, 8)]\n point3h")
    np.testing.assert_array_equal(read(tmp_path, HEAD + both).positions[:, 0], [7, 7, 7])


def test_missing_attributes_have_the_schemas_defaults(tmp_path, caplog):
    alone = """def ParticleField3DGaussianSplat "A"
{
    point3f[] positions.timeSamples = {3: [(1, 2, 3)], 4: [(7, 8, 9)]}
}"""
    scene = read(tmp_path, HEAD + alone)
    np.testing.assert_array_equal(scene.positions.T, [[1, 2, 3]])
    np.testing.assert_array_equal(scene.rot.T, [[1, 0, 0, 0]])
    np.testing.assert_array_equal(scene.log_scale, np.zeros((3, 1)))
    assert scene.sh_degree == 3
    assert not scene.f_dc.any()
    assert not scene.f_rest.any()
    assert scene.opacity[0, 0] > 17
    told = ["without SH, read as grey: 1 prim", "changes at 2 times; the first is read"]
    assert caplog.messages[:2] == [f"{tmp_path / 'a.usda'}: {each}" for each in told]


def with_line(splats: str, line: str) -> str:
    """The prim with another property."""
    return splats.replace("{\n", f"{{\n    {line}\n", 1)


def test_prims_that_are_not_shown_are_left_out(tmp_path, caplog):
    hidden = with_line(SPLATS.replace('"A"', '"B"'), 'token visibility = "invisible"')
    guide = with_line(SPLATS.replace('"A"', '"C"'), 'uniform token purpose = "proxy"')
    expected = read(tmp_path, HEAD + SPLATS)
    assert_same_bits(read(tmp_path, HEAD + hidden), expected)
    assert caplog.messages == []
    assert_same_bits(read(tmp_path, HEAD + hidden + guide + SPLATS), expected)
    told = "left out: prims that are not shown (2)"
    assert caplog.messages == [f"{tmp_path / 'a.usda'}: {told}"]


@pytest.mark.thorough
def test_frames_may_be_prims_that_are_shown_in_turn(tmp_path):
    first, last = ('"inherited"', '"invisible"'), ('"invisible"', '"inherited"')
    line = "token visibility.timeSamples = {{1: {}, 2: {}}}"
    other = SPLATS.replace('"A"', '"B"').replace("(1, 2, 3)", "(7, 8, 9)")
    text = with_line(SPLATS, line.format(*first)) + with_line(other, line.format(*last))
    (tmp_path / "a.usda").write_text(HEAD + text)
    found = [frame.positions.T.tolist() for frame in open_frames(tmp_path / "a.usda")]
    assert found == [[[1, -2, -3], [4, -5, -6]], [[7, -8, -9], [4, -5, -6]]]


def test_times_at_which_attributes_or_places_change_are_frames(tmp_path):
    animated = """def Xform "Moved"
{
    double3 xformOp:translate.timeSamples = {3: (0, 0, 0), 9: (10, 0, 0)}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def ParticleField3DGaussianSplat "A"
    {
        point3f[] positions.timeSamples = {3: [(1, 2, 3)], 6: [(4, 2, 3), (0, 0, 0)]}
        float[] opacities.timeSamples = {3: [1], 6: [1, 0.5]}
    }
}"""
    (tmp_path / "a.usda").write_text(HEAD.replace("(", "(\n    timeCodesPerSecond = 60") + animated)
    frames = open_frames(tmp_path / "a.usda")
    assert (frames.names, frames.fps) == (["0000", "0001", "0002"], 20)
    assert frames.stored_bytes == (tmp_path / "a.usda").stat().st_size
    first, second, third = frames
    np.testing.assert_array_equal(first.positions.T, [[1, -2, -3]])
    np.testing.assert_array_equal(second.positions.T, [[9, -2, -3], [5, 0, 0]])
    np.testing.assert_array_equal(third.positions.T, [[14, -2, -3], [10, 0, 0]])
    np.testing.assert_array_equal(second.opacity, third.opacity)
    (tmp_path / "a.usda").write_text(HEAD + SPLATS)
    with pytest.raises(InvalidInput, match="one scene, expected frames"):
        open_frames(tmp_path / "a.usda")


@pytest.mark.thorough
def test_longer_attributes_are_truncated(tmp_path):
    longer = SPLATS.replace("[0.5, 0.25]", "[0.5, 0.25, 0.125]")
    assert_same_bits(read(tmp_path, HEAD + longer), read(tmp_path, HEAD + SPLATS))


def test_degree_4_is_dropped(tmp_path, caplog):
    def splats(degree: int, kept: int) -> str:
        rows = [(k, k / 2, -k) for g in range(2) for k in range(100 * g, 100 * g + kept)]
        return f"""def ParticleField3DGaussianSplat "A"
{{
    point3f[] positions = [(1, 2, 3), (4, 5, 6)]
    uniform int {SH}Degree = {degree}
    float3[] {SH}Coefficients = {rows}
}}"""

    whole, expected = read(tmp_path, HEAD + splats(4, 25)), read(tmp_path, HEAD + splats(3, 16))
    assert_same_bits(whole, expected)
    assert whole.sh_degree == 3
    path = tmp_path / "a.usda"
    assert caplog.messages[:1] == [f"{path}: left out: SH of degree 4"]


SH = "radiance:sphericalHarmonics"

PLACED = """
def Xform "Above"
{{
    double3 xformOp:translate = (10, 20, 30)
    float xformOp:rotateX = 90
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
{}
}}
"""


def test_prims_are_transformed_to_the_stage(tmp_path):
    plain = read(tmp_path, HEAD + SPLATS)
    scaled = SPLATS.replace(
        "{\n",
        "{\n    float3 xformOp:scale = (-2, 2, 2)\n"
        '    uniform token[] xformOpOrder = ["xformOp:scale"]\n',
        1,
    )
    scene = read(tmp_path, HEAD + PLACED.format(scaled) + SPLATS.replace('"A"', '"B"'))
    assert scene.count == 4
    # Mirrored, twice as large, then 90 degrees about x: y to z, z to -y.
    turn = np.array([[-1, 0, 0], [0, 0, -1], [0, 1, 0]])
    expected = 2 * turn @ plain.positions + np.array([[10], [20], [30]])
    np.testing.assert_allclose(scene.positions[:, :2], expected, atol=1e-5)
    smaller = replace(scene, log_scale=scene.log_scale - np.float32(np.log(2)))
    assert_seen_alike(plain, smaller.between(0, 2), turn)
    assert_same_bits(scene.between(2, 4), plain)


@pytest.mark.thorough
def test_a_stage_whose_z_is_up_is_converted(tmp_path):
    scene = read(tmp_path, HEAD.replace('"Y"', '"Z"') + SPLATS)
    assert scene.coordinates == "RFU"
    back = read_scene(tmp_path / "a.usda")
    np.testing.assert_array_equal(back.positions.T, [[1, -3, 2], [4, -6, 5]])


@pytest.mark.thorough
def test_layers_of_a_usdz_may_refer_to_one_another(tmp_path):
    top = HEAD + 'def Xform "Top" (\n    references = @./parts/b.usda@</A>\n)\n{\n}\n'
    expected = read(tmp_path, HEAD + SPLATS)
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:
        archive.writestr("top.usda", top.replace("def Xform", "def"))
        archive.writestr("parts/b.usda", HEAD + SPLATS)
    assert_same_bits(read_scene(tmp_path / "a.usdz", coordinates=None), expected)


@pytest.mark.thorough
@pytest.mark.parametrize("other", ["c.usda", "../b.usda", "{folder}/b.usda", "b.usdz", "B.USDA"])
def test_a_usdz_that_refers_to_other_files_is_refused(other, tmp_path):
    (tmp_path / "b.usda").write_text(HEAD + SPLATS)
    other = other.format(folder=tmp_path)
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:
        archive.writestr(
            "top.usda", HEAD + f'def "T" (\n    references = @{other}@</A>\n)\n{{\n}}\n'
        )
        archive.writestr("b.usda", HEAD + SPLATS)
        if other != "c.usda":
            archive.writestr(other, HEAD + SPLATS)
    with pytest.raises(InvalidInput, match=r"refers to '.*, expected one file without references"):
        read_scene(tmp_path / "a.usdz")


def edited(old: str, new: str) -> str:
    assert SPLATS.count(old) == 1
    return HEAD + SPLATS.replace(old, new)


BOMB = 'def "A0"\n{\n}\n' + "".join(
    f'def "A{i}"\n{{\n' + "".join(
        f'def "{side}" (\nreferences = </A{i - 1}>\n)\n{{\n}}\n' for side in "LR"
    ) + "}\n"
    for i in range(1, 40)
)  # fmt: skip
BAD = {
    "no Gaussians": (
        HEAD + 'def Xform "A"\n{\n}\n',
        "no ParticleField3DGaussianSplat, not a scene",
    ),
    "no centres": (
        HEAD + 'def ParticleField3DGaussianSplat "A"\n{\n}\n',
        "USD: no positions, expected those of all Gaussians",
    ),
    "version": (HEAD.replace("1.0", "9.9") + SPLATS, "USD: damaged: "),
    "cut off": (HEAD + SPLATS[:-40], r"USD: damaged: scene\.usda:\d+:"),
    "not UTF-8": (HEAD + '"\udcff"', "USD: damaged: "),
    "reference": (
        HEAD + 'def "B" (\n    references = @/etc/b.usda@\n)\n{\n}\n' + SPLATS,
        "refers to '/etc/b.usda', expected one file without references",
    ),
    "payload": (
        HEAD + 'def "B" (\n    payload = @./b.usdc@</A>\n)\n{\n}\n' + SPLATS,
        r"refers to '\./b.usdc'",
    ),
    "layer below": ("#usda 1.0\n(\n    subLayers = [@b.usda@]\n)\n" + SPLATS, "refers to 'b.usda'"),
    "variant": (
        HEAD + 'def "B" (\n    variants = {\n        string v = "x"\n    }\n'
        '    prepend variantSets = "v"\n)\n{\n    variantSet "v" = {\n'
        '        "x" (\n            references = @b.usda@\n        ) {\n        }\n    }\n}\n'
        + SPLATS,
        "refers to 'b.usda'",
    ),
    "clips": (
        HEAD + 'def "B" (\n    clips = {\n        dictionary default = {\n'
        "            asset[] assetPaths = [@b.usda@]\n        }\n    }\n)\n{\n}\n" + SPLATS,
        "refers to 'value clips'",
    ),
    "linear colours": (
        edited("{\n", '{\n    uniform token colorSpace:name = "lin_rec709_scene"\n'),
        "colours in 'lin_rec709_scene', expected sRGB",
    ),
    "text": (
        edited("float[] opacities = [0.5, 0.25]", 'string[] opacities = ["a", "b"]'),
        "damaged",
    ),
    "short": (edited("[0.5, 0.25]", "[0.5]"), "USD: opacities of 1, expected 2"),
    "SH short": (edited("Degree = 1", "Degree = 2"), "Coefficients of 8, expected 18"),
    "degree 5": (edited("Degree = 1", "Degree = 5"), "SH degree 5, expected 0 to 4"),
    "degree -1": (edited("Degree = 1", "Degree = -1"), "SH degree -1, expected 0 to 4"),
    "several degrees": (
        HEAD + SPLATS + 'def ParticleField3DGaussianSplat "B"\n{\npoint3f[] positions = []\n}\n',
        "several SH degrees, expected one",
    ),
    "sheared": (
        edited(
            "{\n",
            "{\n    float3 xformOp:scale = (1, 2, 1)\n"
            '    uniform token[] xformOpOrder = ["xformOp:scale"]\n',
        ),
        "stretches or shears",
    ),
    "deep": (HEAD + 'def "B"\n{\n' * 100_000 + "}\n" * 100_000 + SPLATS, "was stopped by SIGSEGV"),
    "copies of copies": (HEAD + BOMB + SPLATS, "USD: damaged: reading it "),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", BAD)
def test_bad_stages_are_refused_in_one_line(name, tmp_path, monkeypatch):
    monkeypatch.setattr(usd, "_SECONDS", 2)
    text, message = BAD[name]
    path = tmp_path / "a.usda"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.thorough
@pytest.mark.rounds(4)
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_damaged_files_are_refused_in_one_line(suffix, seed, tmp_path):
    data = pack_usd(random_scene(30, 1), suffix)[0]
    rng = np.random.default_rng([seed, len(data)])
    damaged = bytes(changed(data, rng)) if seed % 2 else data[: rng.integers(1, len(data))]
    try:
        scene = read_scene(written(tmp_path / f"a{suffix}", damaged))
    except InvalidInput as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert scene.count >= 1
        assert seed % 2


def test_a_small_file_takes_little_memory(tmp_path, monkeypatch):
    """A length of 7 GB in a file of 1 kB used to be allocated before it was rejected."""
    allowed = []

    def run(command, inputs, output, limits, most):
        allowed.append(limits.memory_bytes)
        assert Path(command[3], "gs_codec", "__init__.py").is_file()  # imported from there
        raise ToolFailed("did not start")

    monkeypatch.setattr(usd, "run_on_files", run)
    for size in (1_000, 10_000_000):
        with pytest.raises(InvalidInput, match="reading it did not start"):
            read_scene(written(tmp_path / "a.usdc", b"PXR-USDC" + bytes(size)))
    assert allowed[0] < 4.01 * (1 << 30) < allowed[1]
