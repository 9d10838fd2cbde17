"""Drives an Open3D visualizer with our actions in it, and prints what came of it as JSON.

Run by test_viewer_window.py, in a process of its own, on a display of its own.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from drive_viewer import grab, tell
from open3d.visualization import O3DVisualizer, gui

import gs_codec
import viewer


def changes(before: np.ndarray, after: np.ndarray) -> int:
    """Number of pixels that differ."""
    return int((np.abs(after - before).max(axis=2) > 12).sum())


def run(folder: Path) -> dict:
    app = gui.Application.instance
    app.initialize()
    visualizer = O3DVisualizer("plugin", 600, 400)
    app.add_window(visualizer)
    actions = viewer.attach(visualizer)

    pictures: list[np.ndarray] = []

    def show() -> None:
        """Add what the window shows once it is another picture than before, and at rest."""
        equal, before = 0, None
        for _ in range(500):
            visualizer.post_redraw()
            app.run_one_tick()
            time.sleep(0.06)
            now = grab(visualizer)
            # A software driver on a busy machine may take long for a frame.
            new = bool(now.any()) if not pictures else bool(changes(pictures[-1], now))
            equal = equal + 1 if new and before is not None and np.array_equal(now, before) else 0
            if equal == 5:
                pictures.append(now)
                return
            before = now
        raise SystemExit("the window shows nothing new, or never rests")

    show()
    try:
        actions.compare(folder / "b.egs")
    except gs_codec.GsCodecError as error:
        refused = str(error)
    for action in (
        lambda: actions.open(folder / "a.ply"),
        lambda: actions.pruned(folder / "report"),
        lambda: actions.compare(folder / "b.egs"),
    ):
        action()
        show()
    count, titles = actions.scene.count, [visualizer.title]
    named = ["centres", "pruned"]
    left = [name for name in named if visualizer.scene.has_geometry(f"gs_codec {name}")]
    actions.detach()
    show()
    titles.append(visualizer.title)
    try:
        actions.open(folder / "a.ply")
    except gs_codec.GsCodecError as error:
        detached = str(error)
    left.append([name for name in named if visualizer.scene.has_geometry(f"gs_codec {name}")])
    changed = [changes(*pair) for pair in zip(pictures, pictures[1:], strict=False)]
    return {
        "changed": changed,
        "refused": refused,
        "count": count,
        "titles": titles,
        "left": left,
        "detached": detached,
    }


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
