"""Files of the scenes shown that change on disk, as while training goes on."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Sequence
from pathlib import Path

from viewer.scenes.opened import times_of
from viewer.window.editor import Editor
from viewer.window.loading import Loading
from viewer.window.shared import Host

#: Interval between looks at the files, seconds, and looks after which a file has been written.
_EVERY, _LOOKS = 0.5, 2

#: A number in the name of a file or its folder, such as ``iteration_7000``.
_NUMBER = re.compile(r"(?<=[_-])\d+(?=\.|$)")


class Watching:
    """Reloads files that change, or says that they have changed.

    Attributes
    ----------
    on : bool
        Whether to reload without being asked.
    """

    def __init__(self, viewer: Host, loading: Loading, editor: Editor) -> None:
        self._viewer, self._loading, self._editor = viewer, loading, editor
        self.on = viewer.request.watch
        self._looked = 0.0
        self._seen: dict[Path, tuple[Sequence[int | None], int]] = {}  # times, and how often

    def set_on(self, on: bool) -> None:
        """Reload without being asked, or only say what has changed."""
        self.on = on
        self._seen.clear()

    def tick(self) -> None:
        """Look at the files, from time to time."""
        if time.monotonic() - self._looked < _EVERY or self._viewer.worker.busy:
            return
        self._looked = time.monotonic()
        for number, scene in enumerate(self._viewer.stage.scenes):
            if not scene.can_reload:
                continue
            path = newest(scene.path) if self.on else scene.path
            now = times_of(scene.files if path == scene.path else (path,))
            before, looks = self._seen.get(path, ((), 0))
            self._seen[path] = now, looks + 1 if now == before else 1
            if now[0] is None or now == scene.modified or self._seen[path][1] != _LOOKS:
                continue
            if self.on and number not in self._editor.unsaved:
                self._loading.reload(number, path)
            else:
                self._viewer.panel.say(f"{path.name} has changed on disk: ctrl + R reloads it")


def newest(path: Path) -> Path:
    """The file with the largest number in place of that in its name or in its folder's."""
    try:
        return _newest(path)
    except OSError:  # folders may be removed, or not be readable
        return path


def _newest(path: Path) -> Path:
    for part in (path, path.parent):
        found = _NUMBER.search(part.name)
        if found is None or not part.parent.is_dir():
            continue
        before, after = part.name[: found.start()], part.name[found.end() :]
        alike = re.compile(f"{re.escape(before)}(\\d+){re.escape(after)}")
        numbers = [int(m[1]) for m in map(alike.fullmatch, os.listdir(part.parent)) if m]
        for number in sorted(numbers, reverse=True):
            other = part.with_name(f"{before}{number}{after}") / path.relative_to(part)
            if number > int(found[0]) and other.is_file():
                return other
    return path
