"""Shared by tests of the viewer's window: files to open, and scripts that drive a window."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.formats.ply.writer import write_ply
from samples.generate import generate
from viewer.scenes.pose import look_at

needs_display = pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool"
)


def make_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two versions of a scene, viewpoints, one photograph, and a report."""
    folder = tmp_path_factory.mktemp("window")
    scene = generate(3000, 1, 31)
    write_ply(folder / "a.ply", scene)
    (folder / "b.egs").write_bytes(encode_scene(scene, Config("s", block_size=1024))[0])
    centre = np.median(scene.positions, axis=1).astype(np.float64)
    size = float(np.quantile(np.abs(scene.positions.T - centre), 0.8))
    poses = [
        look_at(centre + 4 * size * np.array(p), centre) for p in ((0.3, -0.5, -1), (1, -0.5, 0))
    ]
    entries = [pose.camera(200, 150) | {"img_name": f"view{k}"} for k, pose in enumerate(poses)]
    (folder / "cameras.json").write_text(json.dumps(entries))
    (folder / "images").mkdir()
    Image.new("RGB", (40, 30), "red").save(folder / "images" / "view0.png")
    (folder / "report").mkdir()
    np.save(folder / "report" / "labels.npy", (np.arange(3000) % 3 == 0).astype(np.uint8))
    (folder / "report" / "report.json").write_text('{"removed": {"geometry": 1000}}')
    return folder


def drive(script: str, display: str, folder: Path) -> dict:
    """The results of a script in this folder that drives a window.

    Runs it again after a segmentation fault: Mesa 22.3's software driver causes one in a thread of
    its own, about once in some hundred windows.
    """
    here = Path(__file__).parent
    environment = os.environ | {
        "DISPLAY": display,
        "PYTHONPATH": str(here.parent),
        "XDG_STATE_HOME": str(folder / "state"),
    }
    for _ in range(2):
        result = subprocess.run(
            [sys.executable, here / script, folder],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            timeout=600,
        )
        if result.returncode != -signal.SIGSEGV:
            break
    lines = [line for line in result.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, f"{result.stdout}{result.stderr}ended with {result.returncode}"
    return json.loads(lines[0].removeprefix("RESULT "))


def check_drags(drags: list[list]) -> None:
    """Check results of `Driver.drags`: all end like a single event, and return to the start."""
    (before,), *ends = drags
    there, back = np.array(ends).transpose(1, 0, 2, 3, 4)  # by drag and pane: matrices
    moved = np.abs(there[0, 0] - before[0]).max()
    assert moved > 0.5
    assert np.abs(there - there[0, 0]).max() < 0.01 * moved
    assert np.abs(back - before).max() < 0.01 * moved


def crossings(x: float, y: float, corners: list) -> int:
    """Number of a polygon's edges that the ray from a point to the right crosses."""
    found = 0
    for k, (x0, y0) in enumerate(corners):
        x1, y1 = corners[(k + 1) % len(corners)]
        if (y0 > y) != (y1 > y):
            found += x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    return found
