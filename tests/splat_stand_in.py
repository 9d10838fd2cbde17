"""A stand-in for ``splat-transform`` that writes PLY files, and fails according to SPLAT_STAND_IN.

``SPLAT_STAND_IN=fail:.sog`` makes it fail for files with that suffix. It supports only the options
that we use.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

VERSION = "splat-transform v0.1 (stand-in)"


def hang(fifo: str) -> None:
    """Hang for ever, together with a child process; both hold a FIFO open."""
    os.set_inheritable(os.open(fifo, os.O_WRONLY), True)
    forever = [sys.executable, "-I", "-S", "-c", "import time; time.sleep(1e5)"]
    subprocess.Popen(forever, close_fds=False)
    time.sleep(1e5)


def main() -> None:
    failure, _, what = os.environ.get("SPLAT_STAND_IN", "").partition(":")
    if sys.argv[1:] == ["--version"]:
        print("another 1.0" if failure == "other" else VERSION)
        return
    *options, source, target = sys.argv[1:]
    assert options[:3] == ["--quiet", "--gpu", "cpu"]
    assert options[3:] in ([], ["--max-workers", "2"])
    if failure == "hang":
        hang(what)
    if failure == "fail" and target.endswith(what):
        print("some words\n  Error: no good", file=sys.stderr)
        sys.exit(1)
    if failure == "nothing":
        return
    content = Path(source).read_bytes()
    Path(target).write_bytes(b"\xff" * 100 if failure == "garbage" else content)


if __name__ == "__main__":
    main()
