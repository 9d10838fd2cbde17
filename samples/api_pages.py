"""Pages of HTML on the public names of gs_codec and viewer.

    python samples/api_pages.py build/docs

Needs pdoc (extra ``docs``).
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pdoc

sys.path.insert(0, str(Path(__file__).parents[1]))

#: What the public functions return, take and raise, by module.
RETURNED = {
    "gs_codec.config": ("Target",),
    "gs_codec.errors": (
        "GsCodecError",
        "InvalidInput",
        "CorruptStream",
        "TruncatedStream",
        "UnsupportedVersion",
        "MissingTool",
        "ToolFailed",
    ),
    "gs_codec.report": ("EncodeReport", "RateReport", "ChannelCost"),
    "gs_codec.files": ("DecodeReport",),
    "gs_codec.inspection": ("Info", "StreamInfo", "PassInfo"),
    "gs_codec.metrics.attributes": ("Comparison", "GroupError"),
    "gs_codec.metrics.images": ("Quality",),
    "gs_codec.metrics.views": ("RenderedComparison", "View"),
    "gs_codec.api": ("Views",),
    "gs_codec.rendering.camera": ("Camera",),
    "gs_codec.rendering.renderer": ("Rendering", "Accumulations"),
    "gs_codec.preparation.steps": ("Steps",),
    "gs_codec.preparation.pipeline": ("Plan",),
    "gs_codec.preparation.report": ("PrepareReport", "StepReport"),
    "viewer.plugin": ("Actions",),
}


def write_pages(folder: Path) -> None:
    """Write ``index.html`` and a page for each module, of its public names alone."""
    for module, names in RETURNED.items():
        import_module(module).__dict__["__all__"] = list(names)
    for package in map(import_module, ("gs_codec", "viewer")):
        # pdoc looks into modules, and does not ask them.
        package.__dict__.update({name: getattr(package, name) for name in package.__all__})
    pdoc.render.configure(docformat="numpy", show_source=False)
    pdoc.pdoc("gs_codec", "viewer", *RETURNED, output_directory=folder)


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
    print(f"open {Path(sys.argv[1]) / 'gs_codec.html'}")
