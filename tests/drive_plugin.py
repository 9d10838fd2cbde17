"""Drive an Open3D visualizer with our actions, and print the results as JSON.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from drive_viewer import give_up, grab, tell
from open3d.visualization import O3DVisualizer, gui
from PIL import Image

import gs_codec
import viewer
from samples.visualizer import make_visualizer
from viewer.pictures.layers import error_legend, reason_colour

#: Possible geometries.
NAMES = (
    "a.ply: centres", "a.ply: kept", "a.ply: pruned", "b.egs: error against a.ply", "a.ply: splats",
    "cameras.json: cameras",
)  # fmt: skip


#: Legend colours: of the reason for pruning, and of errors.
LEGENDS = np.array([reason_colour(0)]), error_legend("error").bar(256, 1)[0]


#: Width of the scene next to the visualizer's panel, in pixels.
_WIDE = 320


def coloured(
    actions: Any, visualizer: O3DVisualizer, shown: np.ndarray, legend: np.ndarray
) -> list:
    """Number of pixels in a legend colour, and of pixels that are not black."""
    frame = visualizer.content_rect
    bottom = frame.get_bottom()
    if actions._notes.frame is not None:
        bottom = actions._notes.frame.y - visualizer.os_frame.y
    part = shown[frame.y + 5 : bottom - 5, frame.x + 5 : frame.x + _WIDE].reshape(-1, 3)
    lit = part[part.max(axis=1) > 20]
    apart = np.abs(lit[:, None] - np.rint(255 * legend)).max(axis=2).min(axis=1)
    return [int((apart <= 2).sum()), len(lit)]


def changes(before: np.ndarray, after: np.ndarray) -> int:
    """Number of pixels that differ."""
    return int((np.abs(after - before).max(axis=2) > 12).sum())


def run(folder: Path) -> dict:
    app = gui.Application.instance
    app.initialize()
    visualizer, actions = make_visualizer("plugin", 600, 400)

    pictures: list[np.ndarray] = []

    def show() -> None:
        """Store the window's image once it has changed and is stable."""
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
        give_up("the window shows nothing new, or never rests")

    show()
    visualizer.show_skybox(False)
    visualizer.set_background(np.array([0, 0, 0, 1.0]), None)
    show()
    refused = {"compare": told(lambda: actions.compare(folder / "b.egs"))}
    refused["nearest"] = told(actions.nearest)
    named, notes, alike = [], [], []
    for action in (
        lambda: actions.open(folder / "a.ply"),
        lambda: actions.pruned(folder / "report"),
        lambda: actions.compare(folder / "b.egs"),
        lambda: actions.photographs(folder / "cameras.json", folder / "images"),
        lambda: look_from(folder, visualizer, 0),
        actions.nearest,
    ):
        action()
        show()
        named.append([name for name in NAMES if visualizer.scene.has_geometry(name)])
        notes.append(noted(actions, visualizer, pictures[-1]))
        legends = *LEGENDS, actions.scene.colours if actions.scene else LEGENDS[0]
        alike.append([coloured(actions, visualizer, pictures[-1], each) for each in legends])
    here = visualizer.scene.camera.get_model_matrix()
    look_from(folder, visualizer, 1)
    app.run_one_tick()
    refused["photograph"] = told(actions.nearest)
    clear = transparent(actions, visualizer, folder / "images" / "view1.png")
    count = actions.scene.count
    splats(actions, folder / "a.ply")
    show()
    named.append([name for name in NAMES if visualizer.scene.has_geometry(name)])
    actions.detach()
    show()
    named.append([name for name in NAMES if visualizer.scene.has_geometry(name)])
    refused["detached"] = told(lambda: actions.open(folder / "a.ply"))
    changed = [changes(*pair) for pair in zip(pictures, pictures[1:], strict=False)]
    visualizer.close()
    ended = any(not app.run_one_tick() for _ in range(100))
    return {
        "changed": changed,
        "refused": refused,
        "count": count,
        "named": named,
        "notes": notes,
        "alike": alike,
        "here": here[:3, 3].tolist(),
        "ended": ended,
        "clear": clear,
    }


def told(action: Callable[[], object]) -> str:
    """The error message of an action."""
    try:
        action()
    except gs_codec.GsCodecError as error:
        return str(error)
    return "done"


def look_from(folder: Path, visualizer: O3DVisualizer, number: int) -> None:
    """Look from a point next to a camera."""
    camera = gs_codec.read_cameras(folder / "cameras.json")[number]
    right, down, forward = camera.rotation
    eye = camera.position + 0.1 * right
    visualizer.setup_camera(60, eye + forward, eye, -down)


def noted(actions: viewer.plugin.Actions, visualizer: O3DVisualizer, shown: np.ndarray) -> int:
    """Number of colours at the position of the notes window, if it is open."""
    frame = actions._notes.frame
    if frame is None:
        return 0
    x, y = frame.x - visualizer.os_frame.x, frame.y - visualizer.os_frame.y
    part = shown[max(y, 0) : y + frame.height, max(x, 0) : x + frame.width]
    return len(np.unique(part.reshape(-1, 3), axis=0))


def splats(actions: viewer.plugin.Actions, path: Path) -> None:
    """Open a scene as on a graphics card."""
    plugin = sys.modules["viewer.plugin"]
    kept, plugin.find_device = plugin.find_device, lambda: "gpu"
    actions.open(path)
    plugin.find_device = kept


def transparent(actions: Any, visualizer: O3DVisualizer, path: Path) -> list[float]:
    """The colour of a transparent photograph, with another background."""
    Image.new("RGBA", (40, 30), (255, 0, 0, 51)).save(path)
    plugin, found = sys.modules["viewer.plugin"], []
    kept = plugin.draw_notes
    plugin.draw_notes = lambda *notes: found.append(notes[3]) or kept(*notes)
    visualizer.set_background(np.array([0, 1, 0, 1.0]), None)
    actions.nearest()
    plugin.draw_notes = kept
    visualizer.set_background(np.array([0, 0, 0, 1.0]), None)
    path.unlink()
    return found[0][0, 0].tolist()


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
