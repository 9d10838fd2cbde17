"""Drive the viewer's window as on a graphics card, with its switch for exact splats.

Run by test_viewer_window.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from drive_viewer import Driver, tell

import gs_codec
from viewer.scenes.view_request import Request


def apart(driver: Driver, exact: np.ndarray) -> tuple[float, float]:
    """Mean and largest difference between the screen and a picture, in levels of 255."""
    driver.move(5, 5)  # otherwise the switch's tooltip would cover the picture
    frame = driver.viewer.stage.panes[0].widget.frame
    shown = driver.rest()[frame.y : frame.get_bottom(), frame.x : frame.get_right()]
    apart = np.abs(shown - np.rint(255 * exact))
    return float(apart.mean()), float(apart.max())


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    request = Request(folder / "a.ply", cameras=str(folder / "cameras.json"), size=(672, 400))
    driver = Driver(folder, request=request, device="gpu")
    viewer = driver.viewer
    driver.rest()
    stage = viewer.stage
    camera = stage.pose.camera(*stage.picture_size)
    [(_, rendering)] = gs_codec.render(folder / "a.ply", [camera])
    exact = np.clip(rendering.colour, 0, 1)
    found = {"shader": apart(driver, exact), "told": [viewer.panel.scene.numbers.text]}
    driver.click(viewer.panel.scene.exact)
    driver.wait(lambda: viewer.choice.exact)
    found["exact"] = apart(driver, exact)
    found["told"].append(viewer.panel.scene.numbers.text)
    driver.click(viewer.panel.scene.exact)
    driver.wait(lambda: not viewer.choice.exact)
    found["again"] = apart(driver, exact)
    tell(found)
