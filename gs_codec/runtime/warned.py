"""Log warnings of Python and of other packages as single lines."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import TextIO

log = logging.getLogger(__name__)


def log_warnings() -> None:
    """From now on, log the warnings of Python, NumPy and other packages in this process."""
    warnings.showwarning = _log


def _log(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Replacement for `warnings.showwarning`."""
    text = " ".join(str(message).split())
    log.warning("%s (%s, line %d)", text, Path(filename).name, lineno)
