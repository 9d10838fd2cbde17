"""The JavaScript decoder, run by Node, and files for it."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
from scenes import (
    encode_by,
    made_up_guide,
    random_scene,
)

from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.scene import GROUPS, Scene

#: Folder of the tests.
HERE = Path(__file__).parent

#: Path of Node; None if missing.
NODE = shutil.which("node")

#: Golden files of every version of the format, but sequences.
GOLDEN = [path for path in sorted((HERE / "golden").glob("*.egs")) if "sequence" not in path.name]

#: Number of Gaussians of a file of five blocks, and of each block.
COUNT, BLOCK = 4700, 940


def run(*jobs: dict) -> list[dict]:
    """Decode files one after another in one Node process; return the results."""
    texts = [
        {**job, "bytes": base64.b64encode(job["bytes"]).decode()} if "bytes" in job else job
        for job in jobs
    ]
    result = subprocess.run(
        [str(NODE), HERE / "web" / "decode.mjs"],
        input=json.dumps(texts),
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    found = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(found) == len(jobs), result.stderr
    return found


def digest(scene: Scene) -> str:
    """SHA-256 of the floats of a scene, group by group."""
    planes = [np.ascontiguousarray(getattr(scene, group), "<f4") for group in GROUPS]
    return hashlib.sha256(b"".join(plane.tobytes() for plane in planes)).hexdigest()


def upto(scene: Scene, degree: int) -> Scene:
    """The scene without SH above a degree."""
    kept = (degree + 1) ** 2 - 1
    planes = {group: getattr(scene, group) for group in GROUPS}
    coefficients = len(scene.f_rest) // 3
    rows = [c * coefficients + i for c in range(3) for i in range(kept)]
    return Scene(**{**planes, "f_rest": scene.f_rest[rows]})


@cache
def blocks(profile: str = "m") -> bytes:
    """A file of several blocks and classes."""
    config = Config(profile, threads=1, block_size=1024)
    guide = made_up_guide(seed=3) if profile in ADAPTIVE_PROFILES else None
    return encode_by(random_scene(COUNT, 3, seed=3), config, guide)
