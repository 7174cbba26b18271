"""What a command which answers at once does without: imports, and memory that was freed.

Only for a process that is nothing but the command: what is left out here, nobody else may miss.
"""

import ctypes
import sys

from slicematch._deferred_compiler import defer_compiler


def start_quickly() -> None:
    """Put off torch's compiler, and leave out the model hub's client: 1.4 and 0.3 s of 4.

    timm imports the client to fetch weights, and does without where there is none; a run has its
    own weights. And have memory given back that was freed.
    """
    _give_memory_back()
    defer_compiler()
    sys.modules.setdefault("huggingface_hub", None)  # type: ignore[arg-type]


def _give_memory_back() -> None:
    """Have glibc give freed blocks of half a MiB and more back to the system: 25 MB of 440.

    Answers one after the other are faster when it keeps them; this process gives one.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        m_mmap_threshold = -3
        mallopt(m_mmap_threshold, 1 << 19)
