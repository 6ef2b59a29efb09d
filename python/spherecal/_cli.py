"""The command ``spherecal``: the program of the host, in this process."""

from __future__ import annotations

import signal
import sys

from . import _native
from .errors import MISSING


def main() -> int:
    """Runs the program with the process's arguments; its exit code."""
    if not hasattr(_native, "main"):
        print(f"spherecal: {MISSING}", file=sys.stderr)
        return 2
    # Python's handler runs between two instructions of Python, of which there are none here.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.main(["spherecal", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
