"""A report of preparation as files."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gs_codec.io.atomic import write_files
from gs_codec.preparation.report import PrepareReport


def save_report(folder: str | Path, report: PrepareReport) -> None:
    """Write ``report.json``, ``ablation.md`` and ``labels.npy``.

    ``labels.npy`` has a uint8 for each input Gaussian, in the input's order: its index in
    `LABELS`, 0 for those that were kept.

    Raises
    ------
    InvalidInput
        If they cannot be written.
    """
    labels = io.BytesIO()
    np.save(labels, report.labels)
    files = {
        "report.json": json.dumps(report.as_dict(), indent=1).encode() + b"\n",
        "ablation.md": _markdown(report.table()).encode(),
        "labels.npy": labels.getvalue(),
    }
    write_files(folder, files)


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|---" + "|---:" * (len(rows[0]) - 1) + "|")
    return "\n".join(lines) + "\n"
