"""Imports that a command which answers at once does without.

Only in a process of the command's own: what is left out here, nobody else may miss.
"""

import sys
from pathlib import Path

from slicematch._deferred_compiler import defer_compiler


def start_quickly() -> None:
    """Put off torch's compiler, and leave out the model hub's client: 1.4 and 0.3 s of 4.

    timm imports the client to fetch weights, and does without where there is none; a run has its
    own weights.
    """
    if Path(sys.argv[0]).stem not in ("slicemask", "__main__", "cli"):
        return
    defer_compiler()
    if "huggingface_hub" not in sys.modules:
        sys.modules["huggingface_hub"] = None  # type: ignore[assignment]
