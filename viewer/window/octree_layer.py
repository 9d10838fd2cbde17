"""The octree layer of a window; cells are found in the background."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from viewer.pictures.cubes import Cubes
from viewer.pictures.layers import Legend, Points
from viewer.pictures.octree_cells import Octree
from viewer.scenes.choice import OctreeChoice
from viewer.scenes.worker import Stale, Worker
from viewer.window.pane import Pane


class OctreeLayer:
    """Shows or hides the octree cells of the panes' scenes.

    A result is shown even if the slider has moved meanwhile; otherwise none would appear during a
    move. Then cells are found for the newest choice.

    Parameters
    ----------
    worker : Worker
    changed : callable
        Called when the cells shown change.
    failed : callable
        Called with the exception of a failed job.

    Attributes
    ----------
    legend : Legend or None
        Legend of the cells shown.
    """

    def __init__(
        self,
        worker: Worker,
        changed: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._worker, self._changed, self._failed = worker, changed, failed
        self.put([])

    def put(self, panes: Sequence[Pane], cubes: int = 0, points: int = 0) -> None:
        """Use other panes, with no cells yet: at most `cubes` cubes or `points` points."""
        self._worker.cancel("octree")
        self._panes, self._most = list(panes), (cubes, points)
        self._octree: Octree | None = None
        self._wanted: OctreeChoice | None = None
        self._shown: OctreeChoice | None = None
        self._coming = False
        self.legend: Legend | None = None

    def show(self, choice: OctreeChoice | None) -> None:
        """Show the cells of a choice, or hide them."""
        self._wanted = choice
        if choice is None:
            self._show([None] * len(self._panes), None)
        elif choice != self._shown and not self._coming:
            self._start(choice)

    def _start(self, choice: OctreeChoice) -> None:
        """Start finding cells; the tree is built once per scene."""
        panes, most, octree = self._panes, self._most, self._octree

        def find(stale: Stale) -> tuple[Octree, list[Cubes | Points]]:
            tree = octree or Octree([pane.scene for pane in panes])
            return tree, [tree.cells(pane.scene, choice, *most) for pane in panes]

        def done(found: tuple[Octree, list[Cubes | Points]]) -> None:
            self._coming = False
            self._octree = found[0]
            if self._wanted is None:
                return
            self._show(found[1], choice)
            if self._wanted != choice:
                self._start(self._wanted)
            self._changed()

        def failed(error: Exception) -> None:
            self._coming = False
            self._failed(error)

        self._coming = True
        self._worker.submit("octree", find, done, failed)

    def _show(self, cells: Sequence[Cubes | Points | None], choice: OctreeChoice | None) -> None:
        if choice == self._shown:
            return
        self._shown = choice
        legends = [each.legend for each in cells if each is not None and each.legend is not None]
        self.legend = legends[0] if legends else None
        for pane, each in zip(self._panes, cells, strict=True):
            pane.show_cells(each)
