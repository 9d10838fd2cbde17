"""What notebooks display: clouds, reports and pages."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene

import gs_codec
import viewer
from gs_codec.errors import InvalidInput
from gs_codec.files.sharing import share
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from samples.generate import generate, orbit_cameras
from viewer import notebook

NOTEBOOK = Path(__file__).parents[1] / "samples" / "notebook.ipynb"

pytest.importorskip("open3d", exc_type=ImportError)


@pytest.mark.thorough
def test_the_sample_runs(tmp_path):
    """Every result that has a page or a table shows it."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient").NotebookClient
    write_ply(tmp_path / "scene.ply", generate(2000, 1, 4))
    ran = client(
        nbformat.read(NOTEBOOK, 4), timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    shown = [
        output["data"].get("text/html", "")
        for cell in ran.cells
        for output in cell.get("outputs", ())
        if output.output_type == "execute_result"
    ]
    kinds = [re.findall("<(iframe|table)", text)[0] for text in shown]
    assert kinds == ["iframe", "table", "table", "iframe"]


def test_a_frame_contains_the_page_of_share(tmp_path):
    (tmp_path / "cameras.json").write_text(json.dumps(orbit_cameras(2, 64, 48)))
    paths = [tmp_path / "a.ply", tmp_path / "b.egs"]
    write_ply(paths[0], random_scene(300, 1))
    gs_codec.write(paths[1], gs_codec.read(paths[0]))
    share(paths, tmp_path / "page.html", tmp_path / "cameras.json")
    for_links = r'<meta (?:property=|name="(?:description|twitter:card)").*\n'
    page = re.sub(for_links, "", (tmp_path / "page.html").read_text())
    frame = viewer.embed(*paths, cameras=tmp_path / "cameras.json")._repr_html_()
    (source,) = re.findall('srcdoc="([^"]*)"', frame)
    assert html.unescape(source) == page
    # A cloud is encoded in the same way as its file, but has no name.
    cloud = viewer.embed(gs_codec.read(paths[0]), paths[1], cameras=tmp_path / "cameras.json")
    assert cloud.page == page.replace("a.ply", "cloud")


def test_clouds_without_gaussians_show_themselves_as_before():
    import open3d

    cloud = open3d.t.geometry.PointCloud(np.zeros((3, 3), np.float32))
    assert notebook._shown(cloud) is None


def test_clouds_that_cannot_be_encoded_say_why(caplog):
    cloud = to_cloud(random_scene(50, 0))
    cloud.point.positions[3] = np.nan
    assert notebook._shown(cloud) is not None
    assert "left out: 1 Gaussian with NaN or infinity" in caplog.text
    cloud.point.positions[:] = np.nan
    assert notebook._shown(cloud) is None
    assert "the cloud is not shown: " in caplog.text
    assert "all contain NaN or infinity" in caplog.text


def test_wrong_arguments_are_refused(tmp_path, monkeypatch):
    write_ply(tmp_path / "a.ply", random_scene(50, 0))
    with pytest.raises(InvalidInput, match="0 scenes, expected one or two"):
        viewer.embed()
    with pytest.raises(InvalidInput, match="height 10: expected 200 to 4000"):
        viewer.embed(tmp_path / "a.ply", height=10)
    monkeypatch.setattr(notebook, "_MOST", 1000)
    with pytest.raises(InvalidInput, match=r"a page of .* kB, expected at most 1.00 kB; "):
        viewer.embed(tmp_path / "a.ply")
