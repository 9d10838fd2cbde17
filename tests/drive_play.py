"""Play a sequence in a real viewer window; print the results as JSON.

Run by test_viewer_sequences.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from drive_edit import answer
from drive_viewer import Driver, tell
from open3d.visualization import gui

from viewer.scenes.edits import Edits
from viewer.scenes.view_request import Request
from viewer.window.dialogs import inside


def numbers(driver: Driver) -> list[int | None]:
    """The frame shown in each pane."""
    scenes = driver.viewer.stage.scenes
    return [None if scene.moment is None else scene.moment.number for scene in scenes]


def hold(driver: Driver, *frames: int) -> None:
    """Drag the slider from frame to frame."""
    frame, last = driver.viewer.player.bar.slider.frame, driver.viewer.player.moment.clip.count - 1
    for k, number in enumerate(frames):
        x = frame.x + 8 + (frame.width - 16) * number / last
        driver.move(x, frame.y + frame.height / 2)
        if not k:
            driver.xdotool("mousedown", 1)
        driver.tick(2)


def slide(driver: Driver, found: dict) -> None:
    """Drag the slider there and back, step, and play to the end."""
    viewer, player = driver.viewer, driver.viewer.player
    found["pictures"] = [float(driver.scenes(driver.rest()).mean())]
    found["dragged"] = []
    for frames in ((0, 2, 5), (5, 1, 4, 0, 3)):
        hold(driver, *frames)
        driver.xdotool("mouseup", 1)
        driver.wait(lambda: player.wanted == frames[-1])  # noqa: B023
        found["pictures"].append(float(driver.scenes(driver.rest()).mean()))
        found["dragged"].append([player.wanted, *numbers(driver)])
    found["names"] = [label.text for label in viewer.stage.captions]
    driver.key("comma")
    driver.wait(lambda: player.wanted == 2)
    driver.key("period")
    driver.wait(lambda: player.wanted == 3)
    driver.rest()
    driver.click(player.bar.loop)
    driver.wait(lambda: not player.loop)
    driver.key("space")
    driver.wait(lambda: player.wanted == 5 and not player.playing)
    driver.rest()
    found["played"] = [player.wanted, *numbers(driver)]
    player.toggle()
    found["again"] = [player.wanted]
    driver.wait(lambda: player.wanted == 5 and not player.playing)
    driver.rest()
    found["again"] += numbers(driver)
    driver.click(player.bar.loop)
    driver.wait(lambda: player.loop)
    driver.click(player.bar.play)
    driver.wait(lambda: player.playing and numbers(driver)[0] != 5)
    driver.click(player.bar.play)
    driver.wait(lambda: not player.playing)
    driver.rest()
    found["stopped"] = [player.wanted, *numbers(driver)]


def edit(driver: Driver, found: dict) -> None:
    """Edit a frame, save it, and leave it."""
    viewer, player = driver.viewer, driver.viewer.player
    player.seek(2)
    driver.rest()
    viewer.editor.select_range("opacity", 0.5, np.inf)
    driver.key("Delete")
    driver.wait(lambda: viewer.editor.unsaved == [0])
    viewer.editor.save("frame.ply")
    driver.wait(lambda: not viewer.editor.unsaved)
    found["saved"] = viewer.stage.scenes[0].count
    viewer.placing.command()
    found["command"] = viewer.message
    viewer.dismiss()
    viewer.editor.do(lambda edits: edits.undo())
    driver.key("period")
    driver.wait(lambda: viewer.modal.dialog is not None)
    found["asked"] = [player.wanted, *numbers(driver)]
    answer(driver, "Discard the edits")
    driver.wait(lambda: player.wanted == 3)
    driver.rest()
    found["left"] = numbers(driver)


def edit_playing(driver: Driver, found: dict) -> None:
    """Edit a frame while the sequence plays."""
    viewer, player = driver.viewer, driver.viewer.player
    player.toggle()
    driver.wait(lambda: player.playing and numbers(driver)[0] != 3)
    viewer.editor.select_range("opacity", 0.5, np.inf)
    viewer.editor.do(Edits.delete)
    scenes = list(viewer.stage.scenes)
    driver.rest()
    found["edited"] = [player.playing, viewer.editor.unsaved, viewer.stage.scenes == scenes]
    viewer.editor.do(Edits.undo)
    driver.rest()


def slow(driver: Driver, found: dict) -> None:
    """Play although drawing takes as long as the whole sequence; step beyond the last frame."""
    viewer, player = driver.viewer, driver.viewer.player
    driver.key("space")
    driver.wait(lambda: player.playing)
    player._step = player.moment.clip.count
    player._next(player.moment)
    before = numbers(driver)
    driver.wait(lambda: numbers(driver) != before)
    driver.key("space")
    driver.wait(lambda: not player.playing)
    player.seek(5)
    driver.rest()
    viewer.editor.select_range("opacity", 0.5, np.inf)
    driver.key("Delete")
    driver.wait(lambda: viewer.editor.unsaved == [0])
    driver.key("period")
    driver.tick(5)
    found["beyond"] = [player.wanted, viewer.modal.dialog is not None]
    viewer.editor.do(lambda edits: edits.undo())
    driver.rest()


def trial(driver: Driver, found: dict) -> None:
    """Encode a frame, and go on."""
    viewer, player = driver.viewer, driver.viewer.player
    viewer.encoding.encode(viewer.panel.rate.settings)
    driver.wait(lambda: len(viewer.stage.scenes) > 1 and viewer.stage.scenes[1].moment is None)
    viewer.encoding.cancel()
    found["trial"] = numbers(driver)
    player.seek(4)
    driver.wait(lambda: player.moment.number == 4)
    driver.rest()
    found["trial left"] = numbers(driver)
    viewer.loading.open(str(driver.folder / "a.ply"), 0)
    driver.wait(lambda: player.moment is None)
    driver.rest()
    found["bar"] = player.bar.height


def opened(driver: Driver, found: dict) -> None:
    """Open a zip of frames and a folder of frames from the dialog."""
    viewer = driver.viewer
    viewer.loading.ask_open(0)
    driver.tick(10)  # until the field accepts keys
    driver.type_path("frames.zip")
    driver.key("Return")
    driver.wait(lambda: viewer.player.moment is not None)
    driver.rest()
    found["opened"] = [viewer.stage.captions[0].text]
    viewer.loading.ask_open(0)
    driver.tick(10)  # until the field accepts keys
    driver.type_path("frames")
    driver.key("Return")
    listed = [w for w in inside(viewer.modal.dialog) if isinstance(w, gui.Label)]
    driver.wait(lambda: any(label.text.endswith("/frames") for label in listed))
    answer(driver, "Open folder")
    driver.wait(lambda: viewer.stage.scenes[0].name.startswith("frames,"))
    driver.rest()
    found["opened"].append(viewer.stage.captions[0].text)


def run(folder: Path) -> dict:
    os.chdir(folder)
    request = Request(
        folder / "moving.egs",
        folder / "frames",
        cameras=str(folder / "cameras.json"),
        size=(760, 480),
        frame=1,
    )
    driver = Driver(folder, request=request)
    found: dict = {}
    driver.rest()
    found["at first"] = [driver.viewer.player.wanted, *numbers(driver)]
    slide(driver, found)
    edit(driver, found)
    edit_playing(driver, found)
    slow(driver, found)
    trial(driver, found)
    opened(driver, found)
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
