"""Show a scene in Open3D's own visualizer, with the actions of gs_codec in its menu.

python samples/visualizer.py scene.ply                  # its splats or centres
python samples/visualizer.py scene.ply scene.egs        # errors of the other's colours
"""

from __future__ import annotations

import argparse
from pathlib import Path

from open3d.visualization import O3DVisualizer, gui

import viewer
from viewer.plugin import Actions


def make_visualizer(title: str, width: int, height: int) -> tuple[O3DVisualizer, Actions]:
    """A visualizer on the screen, and the actions in its menu."""
    visualizer = O3DVisualizer(title, width, height)
    gui.Application.instance.add_window(visualizer)
    return visualizer, viewer.attach(visualizer)


def main(scene: Path, other: Path | None = None) -> None:
    """Show a scene, or how another version differs from it, until the window is closed."""
    gui.Application.instance.initialize()
    visualizer, actions = make_visualizer(scene.name, 1280, 800)
    visualizer.show_skybox(False)
    actions.open(scene)
    if other is not None:
        actions.compare(other)
    gui.Application.instance.run()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("other", type=Path, nargs="?", help="another version of the scene")
    main(**vars(parser.parse_args()))
