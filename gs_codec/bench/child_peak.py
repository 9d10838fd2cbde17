"""Run a command, and append the peak memory of its process to a file, in bytes.

``python child_peak.py FILE COMMAND...``: a small process of its own, for what a process counts is
at least the memory of the parent it was forked from.
"""

import resource
import subprocess
import sys

if __name__ == "__main__":
    status = subprocess.run(sys.argv[2:], check=False).returncode
    peak = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    with open(sys.argv[1], "a") as file:
        print(peak, file=file)
    sys.exit(status)
