"""Poses saved by the user: a path to fly along, which films can follow."""

from __future__ import annotations

import time
from pathlib import Path

from gs_codec.runtime.wording import counted
from viewer.scenes.flight import flythrough, read_poses, write_poses
from viewer.scenes.pose import Pose
from viewer.scenes.typed_paths import POSES
from viewer.window.shared import Host
from viewer.window.worker import Stale

#: Duration of a flight between successive poses, seconds.
_LEG = 2.0

#: Poses per second of a flight.
_RATE = 30


class Saved:
    """The saved poses, in order.

    Parameters
    ----------
    viewer : Host

    Attributes
    ----------
    poses : list of Pose
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self.poses: list[Pose] = []
        self._flight: list[Pose] = []
        self._begun = 0.0
        self._last: Pose | None = None

    def keep(self) -> None:
        """Save the current pose after the others."""
        pose = self._viewer.stage.pose
        if pose is not None:
            self.poses.append(pose)
            self._viewer.panel.refresh()

    def drop(self) -> None:
        """Remove the pose saved last."""
        del self.poses[-1:]
        self._viewer.panel.refresh()

    @property
    def text(self) -> str:
        """Text with the number of saved poses."""
        count = len(self.poses)
        return f"path: {counted(count, 'pose')}" if count else "path: no poses yet"

    # Flight

    @property
    def flying(self) -> bool:
        """Whether the window shows a flight along the poses."""
        return bool(self._flight)

    def fly(self) -> None:
        """Fly along the poses; stop if already flying."""
        if self.flying or len(self.poses) < 2:
            self._flight = []
            return
        poses, count = list(self.poses), int(_LEG * _RATE * (len(self.poses) - 1))

        def done(flight: list[Pose]) -> None:
            self._flight, self._begun, self._last = flight, time.monotonic(), None

        viewer = self._viewer
        viewer.worker.submit("fly", lambda stale: flythrough(poses, count), done, viewer.fail)

    def tick(self) -> bool:
        """Continue the flight until its end, or until the camera is moved otherwise."""
        if not self.flying:
            return False
        stage = self._viewer.stage
        place = int((time.monotonic() - self._begun) * _RATE)
        if self._last not in (None, stage.pose):
            self._flight = []
            return False
        self._last = self._flight[min(place, len(self._flight) - 1)]
        if place < len(self._flight):
            stage.steer(self._last)
        else:
            self._flight = []
            stage.look_from(self._last)
        return True

    # Files

    def write(self, path: str) -> None:
        """Write the poses to a file of cameras."""
        viewer = self._viewer
        try:
            write_poses(Path(path), self.poses)
        except Exception as error:
            viewer.fail(error)
        else:
            viewer.panel.say(f"{Path(path).name} saved")

    def open(self, path: str) -> None:
        """Replace the saved poses by those of a file of cameras."""
        viewer = self._viewer

        def read(stale: Stale) -> list[Pose]:
            return read_poses(Path(path))

        def done(poses: list[Pose]) -> None:
            self.poses = poses
            viewer.panel.refresh()

        viewer.worker.submit("poses", read, done, viewer.fail)

    def ask_write(self) -> None:
        """Ask where to write the poses, and write them."""
        self._viewer.files.ask_save("Save the path", POSES, self.write, "-path")

    def ask_open(self) -> None:
        """Ask for a file of cameras, and load its poses."""
        self._viewer.files.ask_open("Open a path", POSES, self.open)
