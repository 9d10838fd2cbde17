"""Files of the scenes shown that change on disk, as while training goes on."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

from viewer.scenes.opened import modified
from viewer.window.editor import Editor
from viewer.window.loading import Loading
from viewer.window.shared import Host

#: Interval between looks at the files, seconds; a file that changed between two is still written.
_EVERY = 0.5

#: A number in the name of a file or its folder, such as ``iteration_7000``.
_NUMBER = re.compile(r"(?<=[_-])\d+(?=\.|$)")


class Watching:
    """Reloads files that change, or says that they have changed.

    Parameters
    ----------
    viewer : Host
    loading : Loading
    editor : Editor

    Attributes
    ----------
    on : bool
        Whether to reload without being asked.
    """

    def __init__(self, viewer: Host, loading: Loading, editor: Editor) -> None:
        self._viewer, self._loading, self._editor = viewer, loading, editor
        self.on = viewer.request.watch
        self._looked = 0.0
        self._seen: dict[Path, int | None] = {}
        self._known: dict[Path, int | None] = {}

    def set_on(self, on: bool) -> None:
        """Reload without being asked, or only say what has changed."""
        self.on = on
        self._known.clear()

    def tick(self) -> None:
        """Look at the files, from time to time."""
        if time.monotonic() - self._looked < _EVERY or self._viewer.worker.busy:
            return
        self._looked = time.monotonic()
        for number, scene in enumerate(self._viewer.stage.scenes):
            path = newest(scene.path) if self.on else scene.path
            now = modified(path) if path.is_file() else None
            settled = now == self._seen.get(path) and now != scene.modified
            self._seen[path] = now
            if now is None or not settled or self._known.get(path) == now:
                continue
            self._known[path] = now
            if self.on and number not in self._editor.unsaved:
                self._loading.reload(number, path)
            else:
                self._viewer.panel.say(f"{path.name} has changed on disk: ctrl + R reloads it")


def newest(path: Path) -> Path:
    """The file with the largest number in place of that in its name or in its folder's."""
    for part in (path, path.parent):
        found = _NUMBER.search(part.name)
        if found is None or not part.parent.is_dir():
            continue
        before, after = part.name[: found.start()], part.name[found.end() :]
        numbers = [
            int(name[len(before) : len(name) - len(after)])
            for name in os.listdir(part.parent)
            if name.startswith(before) and name.endswith(after)
            and name[len(before) : len(name) - len(after)].isdecimal()
        ]  # fmt: skip
        for number in sorted(numbers, reverse=True):
            other = part.with_name(f"{before}{number}{after}")
            other = other if part == path else other / path.name
            if number > int(found[0]) and other.is_file():
                return other
    return path
