"""Recently opened files, in any window of this user."""

from __future__ import annotations

import json
import os
from pathlib import Path

from gs_codec.errors import GsCodecError
from gs_codec.runtime.atomic import atomic_writer

#: Maximum number of remembered files.
MOST = 8

#: Maximum length of the list's file, bytes.
_BYTES = 1 << 16


def _list() -> Path:
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local/state") / "gs-viewer/recent.json"


def recent_files() -> list[Path]:
    """Recently opened files, newest first; deleted ones are skipped."""
    try:
        with _list().open("rb") as file:
            names = json.loads(file.read(_BYTES))
    except (OSError, ValueError, RuntimeError):  # also without a home
        return []
    names = [n for n in names if isinstance(n, str)] if isinstance(names, list) else []
    return [Path(name) for name in names if "\0" not in name and os.path.exists(name)][:MOST]


def remember(path: Path) -> None:
    """Put a file first in the list; ignored if the list cannot be written."""
    path = path.absolute()
    names = [str(path), *(str(each) for each in recent_files() if each != path)]
    try:
        _list().parent.mkdir(parents=True, exist_ok=True)
        with atomic_writer(_list()) as file:
            file.write(json.dumps(names[:MOST], indent=1).encode("utf-8", "surrogatepass"))
    except (OSError, GsCodecError, RuntimeError):
        return
