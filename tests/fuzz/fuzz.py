"""Coverage-guided fuzzing of file readers; needs ``pip install -e '.[fuzz]'``.

``python tests/fuzz/fuzz.py TARGET [--minutes 30] [--corpus FOLDER]`` prints a line of JSON with the
executions and findings. Findings are saved in FOLDER/found, and fuzzing continues; copy one to
``tests/fuzz/found/TARGET`` to make it a test.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE)]

#: Maximum bytes of an input; maximum seconds and MiB for an input.
_LONGEST, _SECONDS, _MEMORY = 1 << 16, 60, 4096


def run(name: str, minutes: float, corpus: Path) -> dict[str, object]:
    """Fuzz a target for some minutes, whatever is found."""
    from targets import TARGETS

    inputs, found = corpus / "inputs", corpus / "found"
    for folder in (inputs, found):
        folder.mkdir(parents=True, exist_ok=True)
    for seed in TARGETS[name].seeds():
        (inputs / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    start, executions, coverage, crashes = time.monotonic(), 0, 0, 0
    while (left := 60 * minutes - (time.monotonic() - start)) > 1:
        command = [sys.executable, str(HERE / "engine.py"), name]
        command += [f"-max_total_time={round(left)}", f"-max_len={_LONGEST}"]
        command += [f"-timeout={_SECONDS}", f"-rss_limit_mb={_MEMORY}"]
        command += [f"-artifact_prefix={found}{os.sep}", "-print_final_stats=1", str(inputs)]
        with (corpus / "log").open("w+") as log:
            status = subprocess.run(command, stderr=log, stdout=log, check=False).returncode
            log.seek(0)
            text = log.read()
        counts = re.findall(r"number_of_executed_units: (\d+)", text) or re.findall(
            r"^#(\d+)", text, re.MULTILINE
        )
        executions += int(counts[-1]) if counts else 0
        coverage = max([coverage, *map(int, re.findall(r" cov: (\d+)", text))])
        if status:
            crashes += 1
            (corpus / f"finding-{crashes}.log").write_text(text[-20_000:])
            if not counts:
                break
    return {
        "target": name,
        "minutes": round((time.monotonic() - start) / 60, 1),
        "executions": executions,
        "coverage": coverage,
        "inputs": len(list(inputs.iterdir())),
        "findings": crashes,
    }


def main() -> int:
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", choices=[*TARGETS, "all"])
    parser.add_argument("--minutes", type=float, default=30.0, help="for each target")
    parser.add_argument("--corpus", type=Path, help="folder for inputs and findings; kept")
    options = parser.parse_args()
    failed = False
    for name in TARGETS if options.target == "all" else (options.target,):
        corpus = options.corpus or Path(tempfile.mkdtemp(prefix="gs-codec-fuzz-"))
        report = run(name, options.minutes, corpus / name)
        print(json.dumps(report), flush=True)
        failed = failed or bool(report["findings"])
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
