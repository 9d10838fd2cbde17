"""Decode on a device, for tests: `python device_work.py FOLDER`, in numba's simulator.

Next to each `.egs` in the folder it writes its tensors (`.npz`) or the type of its error (`.txt`).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numba.cuda.simulator import kernel

from gs_codec.api.splats import decode_tensors
from gs_codec.errors import GsCodecError

#: Argument types of each kernel.
KINDS: dict = {}

FIELDS = ("means", "quats", "log_scales", "logits", "sh")


def run(self, place: tuple, *arguments) -> None:
    """Run one thread of a block; the simulator's own code would poll all the time."""
    thread = kernel.BlockThread(lambda: self._f(*arguments), self, place, (0, 0, 0), self._debug)
    thread.start()
    thread.join()
    if thread.exception:
        raise thread.exception[0].with_traceback(thread.exception[1])


def launch(self, *arguments) -> None:
    """Run a kernel; a device compiles each for a single list of types."""
    types = [(getattr(a, "dtype", type(a)), getattr(a, "ndim", 0)) for a in arguments]
    assert KINDS.setdefault(self.fn, types) == types, self.fn
    launch_kernel(self, *arguments)


kernel.BlockManager.run = run
launch_kernel = kernel.FakeCUDAKernel.__call__
kernel.FakeCUDAKernel.__call__ = launch
for path in sorted(Path(sys.argv[1]).glob("*.egs")):
    try:
        splats = decode_tensors(path)
    except GsCodecError as error:
        path.with_suffix(".txt").write_text(type(error).__name__)
    else:
        np.savez(path.with_suffix(".npz"), **{name: getattr(splats, name) for name in FIELDS})
