"""Add the kernels that tests and documents have compiled to the list of kernels.

    NUMBA_CACHE_DIR=build/kernels make test-all
    .venv/bin/python .ci/record_kernels.py build/kernels

It prints new lines, and lines that were not compiled; `--write` updates the list.
"""

from __future__ import annotations

import argparse
import pickle
import re
from collections.abc import Iterator
from pathlib import Path

import gs_codec
from gs_codec.runtime.kernel_list import Entry, entry_of, read_list, write_list

PACKAGE = Path(gs_codec.__file__).parent


def compiled(folder: Path) -> Iterator[Entry]:
    """Kernels in numba's index files in a folder."""
    from gs_codec.runtime.kernel_cache import place_name

    sources = {place_name(str(path)): path for path in PACKAGE.rglob("*.py")}
    for index in folder.rglob("*.nbi"):
        source = sources.get(index.parent.name)
        named = re.match(r"\w+\.(\w+)-\d+\.", index.name)
        if source is None or named is None:  # from a test, or from an earlier source
            continue
        module = ".".join(source.relative_to(PACKAGE.parent).with_suffix("").parts)
        with index.open("rb") as file:
            pickle.load(file)
            _, overloads = pickle.loads(file.read())
        kernel = Entry(module, named[1], "").kernel()
        for types, *_ in overloads:
            yield entry_of(kernel.py_func, types)


def main() -> None:
    """Print the changes, and write them if `--write` is given."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="NUMBA_CACHE_DIR of the run")
    parser.add_argument("--write", action="store_true", help="add new lines to the list")
    asked = parser.parse_args()
    listed, found = set(read_list()), set(compiled(asked.folder))
    for entry in sorted(found - listed):
        print("new", *entry)
    for entry in sorted(listed - found):
        print("not compiled", *entry)
    if asked.write:
        write_list(listed | found)


if __name__ == "__main__":
    main()
