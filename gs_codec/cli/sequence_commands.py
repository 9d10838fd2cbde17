"""Sequences: what `encode`, `decode`, `inspect`, `compare` and `verify` do with them."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import bars, print_status, print_table, print_text, progress_bar, smaller
from gs_codec.cli.streams import is_stdout
from gs_codec.cli.typed import Typed
from gs_codec.config import EGS
from gs_codec.errors import InvalidInput
from gs_codec.pages.tables import Table
from gs_codec.runtime.wording import counted, size_text

if TYPE_CHECKING:
    from gs_codec.sequences.frame_decoding import Sequence
    from gs_codec.sequences.frame_encoding import SequenceReport

#: Options of `encode` without effect on a sequence.
_WHOLE_SCENES = (
    "preset", "gt_images", "refine", "prune", "gaussians", "target_bpg",
    "max_memory", "extra", "input_format", "lod", "allow_prune",
)  # fmt: skip

#: Options of `decode` without effect on a sequence.
_OF_SCENES = (
    "bbox", "sh_degree", "level", "view", "budget", "tolerance", "dask", "tmc3", "max_memory",
)  # fmt: skip

#: Maximum number of columns of the plot of bytes.
_COLUMNS = 60


def moves(file: Path) -> bool:
    """Whether a file or folder has frames; of an `.egs`, without loading code that reads frames."""
    from gs_codec.egs.frame_sections import is_sequence

    found = is_sequence(file)
    if found is None:
        from gs_codec.sequences.frame_sources import has_frames

        found = has_frames(file)
    return found


def encode(source: Path, file: Path, target: Path, typed: Typed) -> None:
    """Encode the frames of a folder, pattern, zip or animation at `file`, called `source`."""
    from gs_codec.cli.typed_request import request_of
    from gs_codec.sequences.frame_encoding import GROUP
    from gs_codec.sequences.frame_targets import encode_requested

    _refuse_stdout(target)
    typed.refuse(_WHOLE_SCENES, "has no effect on a sequence of frames")
    if typed.actions:
        raise InvalidInput(f"{typed.actions[0].typed}: has no effect on a sequence of frames")
    request = request_of(typed, target)
    config = request.config
    with progress_bar() as progress:
        done = encode_requested(
            file, target, request, typed["group"] or GROUP, typed["fps"], progress,
            typed["overwrite"],
        )  # fmt: skip
    if done.frames == 1:
        print_status(f"{source}: a sequence of one frame; name its file to encode it as a scene")
    if typed["json"]:
        shown = asdict(done)
        print_document(
            input=str(source), output=str(target), profile=config.profile, format=EGS,
            output_bytes=shown.pop("file_bytes"), bits_per_second=done.bits_per_second,
            stages=shown.pop("seconds"), **shown,
        )  # fmt: skip
        return
    _tell_encoded(target, done)


def _tell_encoded(target: Path, done: SequenceReport) -> None:
    print_text(
        f"{target}: {counted(done.frames, 'frame')} at {done.fps:g} fps, "
        f"{counted(done.count, 'Gaussian')}, "
        f"{smaller(done.input_bytes, done.file_bytes, done.ratio)}, "
        f"{done.bits_per_second / 1e6:.2f} Mbit/s, {sum(done.seconds.values()):.2f} s"
    )
    print_text(_keys_text(done.key_frames, done.frames, done.key_bytes / done.file_bytes))
    if done.coarseness != 1:
        chosen = f"after {counted(done.encodings, 'encoding')}"
        if done.encodings == 1:
            chosen = "(chosen automatically)"
        print_text(f"step sizes {done.coarseness:.2f}x those of the profile {chosen}")
    if done.psnr_drop is not None:
        print_text(
            f"views lose {done.psnr_drop:.3f} dB on average over measured frames; most in "
            f"{done.worst_frame}: {done.worst_drop:.3f} dB"
        )


def _keys_text(keys: int, frames: int, share: float) -> str:
    text = f"{counted(keys, 'key frame')}, {share:.0%} of the file"
    if keys == frames > 1:
        text += (
            "; each frame is a scene of its own, because its Gaussians differ from those before, "
            "or too many change"
        )
    return text


def decode(
    source: Path, file: Path, target: Path, typed: Typed, frame: int | None, time: str | None
) -> None:
    """Decode frames of a sequence at `file`, called `source`, to a folder, or one to a PLY."""
    from gs_codec.runtime.threads import using_threads
    from gs_codec.sequences.frame_decoding import decode_to_files

    _refuse_stdout(target)
    typed.refuse(_OF_SCENES, f"has no effect on {source}, a sequence")
    span = None if time is None else _seconds(time)
    if frame is not None and span is not None:
        raise InvalidInput("--frame and --time cannot be combined")
    with progress_bar() as progress, using_threads(typed["threads"]):
        done = decode_to_files(
            file, target, frame, span, progress, typed["max_bytes"], typed["overwrite"]
        )
    if typed["json"]:
        shown = asdict(done)
        print_document(
            input=str(source), output=str(target), format="ply",
            input_bytes=shown.pop("file_bytes"), **shown,
        )  # fmt: skip
        return
    print_text(
        f"{target}: {counted(done.frames, 'frame')}, {counted(done.count, 'Gaussian')}, "
        f"{size_text(done.output_bytes)}, {done.seconds:.2f} s"
    )


def _refuse_stdout(target: Path) -> None:
    if is_stdout(target):
        raise InvalidInput(f"{target}: stdout is for one scene, expected a name for a sequence")


def _seconds(text: str) -> tuple[float, float]:
    """The seconds of ``START-END``."""
    found = re.fullmatch(r"(\d{1,9}(?:\.\d*)?)-(\d{1,9}(?:\.\d*)?)", text)
    if not found:
        raise InvalidInput(f"--time {text}: expected START-END in seconds, for example 1.5-3")
    return float(found[1]), float(found[2])


def inspect(source: Path, file: Path, typed: Typed) -> None:
    """Show the frames of a sequence at `file`, called `source`."""
    from gs_codec.codecs.inspection import describe
    from gs_codec.egs.frame_sections import is_sequence, open_key_frame
    from gs_codec.sequences.frame_decoding import opened_sequence

    why = f"has no effect on {source}, a sequence"
    typed.refuse(["channels", "histogram", "gpu"], why)
    if not is_sequence(file):
        _inspect_frames(source, file, typed)
        return
    typed.refuse(["max_bytes"], why)
    with opened_sequence(file) as sequence:
        first = describe(open_key_frame(sequence.file, 0))
        shown = _described(sequence)
    if typed["json"]:
        print_document(
            input=str(source), format=EGS, profile=first.profile, gaussians=first.count,
            sh_degree=first.sh_degree, **shown,
        )  # fmt: skip
        return
    frames, size = shown["frames"], shown["input_bytes"]
    seconds = frames / shown["fps"]
    print_text(
        f"{source}: sequence of {counted(frames, 'frame')} at {shown['fps']:g} fps, "
        f"{seconds:.2f} s, {size_text(size)}, {8 * size / seconds / 1e6:.2f} Mbit/s",
        f"profile {first.profile}, SH degree {first.sh_degree}, "
        f"{counted(first.count, 'Gaussian')} in the first frame",
        _keys_text(len(shown["groups"]), frames, _key_bytes(shown) / size),
    )
    sizes = shown["frame_bytes"]
    step = -(-len(sizes) // _COLUMNS)
    most = [max(sizes[k : k + step]) for k in range(0, len(sizes), step)]
    print_text(f"bytes of frames: |{bars(most)}|")
    rows = [
        [
            f"{each['first']}", each["name"], f"{each['first'] / shown['fps']:.2f}",
            f"{each['frames']}", size_text(each["key_bytes"]), size_text(each["motion_bytes"]),
        ]
        for each in shown["groups"]
    ]  # fmt: skip
    columns = ["key frame", "name", "second", "frames", "key bytes", "motion bytes"]
    print_table(Table(columns, rows, left=(1,)))


def _inspect_frames(source: Path, file: Path, typed: Typed) -> None:
    """Show the frames of a folder, a pattern, a zip or an animation at `file`."""
    from gs_codec.sequences.frame_sources import open_frames

    frames = open_frames(file, None, "drop", typed["max_bytes"])
    first = frames.read(0)
    if typed["json"]:
        print_document(
            input=str(source), gaussians=first.count, sh_degree=first.sh_degree,
            input_bytes=frames.stored_bytes, frames=len(frames), fps=frames.fps, names=frames.names,
        )  # fmt: skip
        return
    rate = "" if frames.fps is None else f" at {frames.fps:g} fps"
    print_text(
        f"{source}: {counted(len(frames), 'frame')}{rate}, {size_text(frames.stored_bytes)}; "
        "`encode` makes a sequence of them",
        f"first frame '{frames.names[0]}': {counted(first.count, 'Gaussian')}, "
        f"SH degree {first.sh_degree}",
    )


def _key_bytes(shown: dict[str, Any]) -> int:
    return sum(group["key_bytes"] for group in shown["groups"])


def _described(sequence: Sequence) -> dict[str, Any]:
    """Frames and groups of a sequence, for JSON."""
    from gs_codec.egs.egs_file import FRAME_SECTIONS

    timeline, file = sequence.timeline, sequence.file
    sizes = [entry.size for (section, _), entry in file.table.items() if section in FRAME_SECTIONS]
    ends = [*timeline.keys[1:], timeline.count]
    groups = [
        {
            "first": key,
            "name": timeline.name_of(key),
            "frames": end - key,
            "key_bytes": sizes[key],
            "motion_bytes": sum(sizes[key + 1 : end]),
        }
        for key, end in zip(timeline.keys, ends, strict=True)
    ]
    return {
        "frames": timeline.count,
        "fps": timeline.fps,
        "input_bytes": len(file.data),
        "groups": groups,
        "frame_bytes": sizes,
    }


def compare(
    first: Path, second: Path, typed: Typed, cameras: str | None, drawn: dict[str, Any]
) -> None:
    """Compare two versions of a sequence in rendered views."""
    from gs_codec.sequences.frame_comparison import compare_frames

    typed.refuse(["gt_images", "images", "lpips", "overwrite"], "has no effect on sequences")
    with progress_bar() as progress:
        found = [
            (name, comparison.mean.between.psnr, comparison.worst.between.psnr)
            for name, comparison in compare_frames(
                [first, second], cameras or "auto", progress=progress,
                max_bytes=typed["max_bytes"], **drawn,
            )
        ]  # fmt: skip
    mean = sum(psnr for _, psnr, _ in found) / len(found)
    lowest = min(found, key=lambda row: row[1])
    if typed["json"]:
        frames = [{"name": name, "psnr": psnr, "worst": worst} for name, psnr, worst in found]
        print_document(input=[str(first), str(second)], frames=frames, psnr=mean)
        return
    rows = [[name, f"{psnr:.3f}", f"{worst:.3f}"] for name, psnr, worst in found]
    print_table(Table(["frame", "PSNR (dB)", "worst view"], rows))
    print_text(
        f"{counted(len(found), 'frame')}: {mean:.3f} dB on average; lowest {lowest[1]:.3f}, in "
        f"{lowest[0]}"
    )


def verify(source: Path, file: Path, typed: Typed) -> None:
    """Read all frames at `file`, called `source`."""
    import time

    from gs_codec.egs.frame_sections import is_sequence
    from gs_codec.runtime.threads import using_threads
    from gs_codec.sequences.frame_sources import open_frames

    typed.refuse(["max_memory", "tmc3"], f"has no effect on {source}, a sequence")
    began = time.perf_counter()
    with using_threads(typed["threads"]):
        frames = open_frames(file, None, "keep", typed["max_bytes"])
        count = sum(scene.count for scene in frames)
    seconds = time.perf_counter() - began
    if typed["json"]:
        print_document(
            input=str(source), format=EGS if is_sequence(file) else None, seconds=seconds,
            input_bytes=frames.stored_bytes, gaussians=count, frames=len(frames), fps=frames.fps,
        )  # fmt: skip
        return
    print_text(
        f"{source}: sound, {size_text(frames.stored_bytes)}, {counted(len(frames), 'frame')}, "
        f"{counted(count, 'Gaussian')} in all, {seconds:.2f} s"
    )
