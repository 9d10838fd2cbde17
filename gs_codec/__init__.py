"""Entropy coding of 3D Gaussian Splatting scenes (EntropyGS, arXiv 2508.10227).

Scenes are Open3D point clouds, one attribute tensor for each property of the Gaussians:

    cloud = gs_codec.read("scene.ply")
    data = gs_codec.encode(cloud, gs_codec.Config("m"))
    decoded = gs_codec.decode(data)

Names are loaded on first use, so ``import gs_codec`` is fast. Every error is a `GsCodecError`.
Nothing is printed, and no function modifies its arguments.
"""

from __future__ import annotations

from gs_codec.runtime.lazy import lazy_names

__version__ = "1.1.0"

#: Modules and their public names.
_PUBLIC = {
    "gs_codec.config": ("Config", "RateTarget"),
    "gs_codec.plan": ("Plan", "Steps"),
    "gs_codec.presets": ("Preset", "preset"),
    "gs_codec.codecs.part": ("Part",),
    "gs_codec.cameras.camera": ("Camera",),
    "gs_codec.cameras.lens": ("Lens",),
    "gs_codec.cameras.camera_files": ("read_cameras", "write_cameras"),
    "gs_codec.errors": (
        "GsCodecError",
        "InvalidInput",
        "CorruptStream",
        "TruncatedStream",
        "UnsupportedVersion",
        "MissingTool",
        "ToolFailed",
    ),
    "gs_codec.api.point_clouds": ("read", "write", "encode", "decode", "inspect"),
    "gs_codec.api.octree": ("to_octree",),
    "gs_codec.api.splats": ("decode_tensors", "encode_tensors", "Splats"),
    "gs_codec.api.trainer_compression": ("Compression",),
    "gs_codec.api.trainer_tensors": ("from_tensors", "to_tensors"),
    "gs_codec.api.viewing": ("compare", "render", "prepare"),
    "gs_codec.metrics.image_quality": ("compare_images", "Quality", "View"),
    "gs_codec.files.encode_file": ("encode_file",),
    "gs_codec.files.decode_file": ("decode_file", "DecodeReport"),
    "gs_codec.distributed.encoding": ("encode_distributed",),
    "gs_codec.distributed.decoding": ("decode_distributed",),
    "gs_codec.sequences.frame_clouds": ("encode_sequence", "decode_sequence"),
    "gs_codec.sequences.frame_encoding": ("SequenceReport",),
    "gs_codec.files.preparing": ("prepare_file",),
    "gs_codec.files.conversion": ("convert_file", "ConvertReport"),
    "gs_codec.report": (
        "EncodeReport",
        "ChannelCost",
        "RateReport",
        "RenderedLoss",
        "ActionReport",
    ),
    "gs_codec.codecs.inspection": ("Info", "StreamInfo", "PassInfo", "LevelInfo"),
    "gs_codec.metrics.comparison": ("Comparison", "GroupError"),
    "gs_codec.preparation.prepare_report": ("PrepareReport", "StepReport"),
    "gs_codec.codecs.entropygs.section": ("Channel",),
    "gs_codec.codecs.adaptive.lattice": ("PositionGrid",),
    "gs_codec.rendering.renderer": ("RenderedViews", "Rendering", "Accumulations"),
}

__all__, __getattr__ = lazy_names(__name__, _PUBLIC, ["edit", "viewer"])


def __dir__() -> list[str]:
    return sorted([*__all__, "edit", "viewer"])
