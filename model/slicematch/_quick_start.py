"""Imports that a command which answers at once does without.

Only for a process that is nothing but the command: what is left out here, nobody else may miss.
"""

import sys

from slicematch._deferred_compiler import defer_compiler


def start_quickly() -> None:
    """Put off torch's compiler, and leave out the model hub's client: 1.4 and 0.3 s of 4.

    timm imports the client to fetch weights, and does without where there is none; a run has its
    own weights.
    """
    defer_compiler()
    sys.modules.setdefault("huggingface_hub", None)  # type: ignore[arg-type]
