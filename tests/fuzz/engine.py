"""A process for a fuzzing engine: fuzz one target until time runs out or something is found.

``python tests/fuzz/engine.py TARGET [options of libFuzzer] CORPUS``
"""

from __future__ import annotations

import logging
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

import atheris

ROOT = Path(__file__).parents[2]
PACKAGES = ("gs_codec", "plyfile", "PIL", "zipfile", "json")


def kernel_modules() -> list[str]:
    """Modules with kernels, whose code must not be instrumented."""
    spec = find_spec("gs_codec")
    assert spec is not None
    assert spec.origin is not None
    package = Path(spec.origin).parent
    return [
        ".".join(("gs_codec", *path.relative_to(package).with_suffix("").parts))
        for path in sorted(package.rglob("*.py"))
        if "gs_codec.runtime.kernels import" in path.read_text() or "numba" in path.read_text()
    ]


def main() -> None:
    name = sys.argv[1]
    sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "fuzz")]
    warnings.simplefilter("ignore")
    logging.disable()
    with atheris.instrument_imports(include=list(PACKAGES), exclude=kernel_modules()):
        from targets import TARGETS
    target = TARGETS[name]
    for seed in target.seeds():
        target.check(seed)  # compile all kernels now
    atheris.Setup([sys.argv[0], *sys.argv[2:]], target.check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
