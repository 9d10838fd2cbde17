"""The TypeScript types of the JavaScript decoder match its code."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from moving_scenes import coded, moving

HERE = Path(__file__).parent
SOURCE = HERE.parent / "viewer" / "web" / "src"
COMPILER = HERE / "web" / "node_modules" / "typescript" / "bin" / "tsc"
NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="needs Node")

FOUND = """
const names = await import('SOURCE');
const data = (await import('node:fs')).readFileSync('FILE');
const file = await names.open(data);
const ofClass = (thing) => Object.getOwnPropertyNames(Object.getPrototypeOf(thing));
const all = (thing) => [...Object.keys(thing), ...ofClass(thing)];
const scene = await names.decode(data);
const sequence = await names.openSequence((await import('node:fs')).readFileSync('MOVING'));
const group = await sequence.group(0);
console.log(JSON.stringify({
    names: Object.keys(names),
    Scene: all(scene), EgsFile: all(file), Level: Object.keys(file.levels[1]),
    Sequence: all(sequence), Group: all(group), Changes: Object.keys(await group.next()),
}));
"""


@pytest.mark.thorough
@pytest.mark.skipif(not COMPILER.is_file(), reason="needs npm ci in tests/web")
def test_examples_are_checked():
    options = "--noEmit --strict --target es2022 --module esnext --moduleResolution bundler"
    done = subprocess.run(
        [str(NODE), COMPILER, *options.split(), HERE / "web" / "types.ts"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_types_name_existing_exports(tmp_path):
    text = (SOURCE / "index.d.ts").read_text()
    script = FOUND.replace("SOURCE", (SOURCE / "index.js").as_uri())
    script = script.replace("FILE", str(HERE / "golden" / "v1-levels.egs"))
    coded(tmp_path / "a.egs", moving(9, 2))
    script = script.replace("MOVING", str(tmp_path / "a.egs"))
    command = [str(NODE), "--input-type=module", "-e", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    names = re.findall(r"^export (?:class|function) (\w+)", text, re.MULTILINE)
    assert sorted(names) == sorted(found["names"])
    facts = members(text, "Facts")
    for name in ("Scene", "EgsFile", "Level", "Sequence", "Group", "Changes"):
        more = facts if name in ("EgsFile", "Sequence") else set()
        assert members(text, name) | more <= set(found[name]), name


def members(text: str, name: str) -> set[str]:
    """Members declared by a class or interface."""
    head = rf"^export (?:class|interface) {name}\b"
    [body] = re.findall(rf"{head}[^{{]*{{\n(.*?)^}}", text, re.M | re.S)
    return set(re.findall(r"^  (?:readonly )?(\w+)\??[:(]", body, re.M)) - {"constructor"}
