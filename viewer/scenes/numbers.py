"""Texts for the panel's numbers: sizes, bits, and quality of the view."""

from __future__ import annotations

import numpy as np

import gs_codec
from gs_codec.runtime.wording import size_text
from viewer.scenes.opened import Opened


def facts(scene: Opened) -> list[tuple[str, str]]:
    """Rows of text for a scene: Gaussians, SH degree, size, and bits of each attribute."""
    rows = [("Gaussians", f"{scene.count:,}")]
    if scene.whole is not None:
        rows.append(("  of the file", f"{scene.file_count:,}"))
    if scene.moment is None and scene.damaged:  # frames may come too fast to count
        rows.append(("  NaN, not drawn", f"{scene.damaged:,}"))
    rows.append(("SH degree", str(scene.sh_degree)))
    if scene.moment is not None:
        clip = scene.moment.clip
        bits = 8 * clip.stored_bytes / (clip.count * clip.seconds)
        rows += [
            ("frame", f"{scene.moment.number} of 0-{clip.count - 1}"),
            ("frames / s", f"{1 / clip.seconds:g}" + ("" if clip.fps else " assumed")),
            ("all frames", size_text(clip.stored_bytes)),
            ("per second", f"{bits / 1e6:.2f} Mbit"),
        ]
    if scene.file_bytes is not None:
        bits, raw = (
            8 * scene.file_bytes / max(scene.file_count, 1),
            (scene.whole or scene).raw_bytes,
        )
        rows += [
            ("file", size_text(scene.file_bytes)),
            ("float32 / file", f"{raw / scene.file_bytes:.1f}"),
            ("bits / Gaussian", f"{bits:.1f}"),
        ]
    if scene.info is not None:
        rows.append(("profile", scene.info.profile))
        rows += [(f"  {s.name}", f"{s.bits_per_gaussian:.2f}") for s in scene.info.streams]
    return rows


def between(first: Opened, second: Opened) -> list[tuple[str, str]]:
    """Rows of text that compare two scenes' sizes; file sizes only for unedited files."""
    rows, edited = [], first.whole or second.whole
    if first.file_bytes and second.file_bytes and not edited:
        rows.append(("A's file / B's", f"{first.file_bytes / second.file_bytes:.1f}"))
    if first.count != second.count:
        share = second.count / max(first.count, 1)
        rows.append(("Gaussians left", f"{100 * share:.1f} %"))
    return rows


def quality_text(quality: gs_codec.Quality) -> str:
    """PSNR and SSIM from `gs_codec.compare_images`, as text."""
    if np.isinf(quality.psnr):
        return "the same"
    return f"{quality.psnr:.2f} dB, SSIM {quality.ssim:.4f}"
