"""``python -m benchmarks.score_bank BANK``: one pair against a bank, in a process of its own.

Prints the processor's seconds of each call on one thread, two of them unless there are many poses,
and the bytes that the first took beyond what was there.
"""

import json
import re
import sys
import time
from pathlib import Path

import torch
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates

from benchmarks.scoring import random_pair
from slicemask import open_bank


def _bytes(name: str) -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(rf"{name}:\s*(\d+) kB", status)[1])


def main(path: str) -> None:
    with open_bank(path) as bank:
        candidates = Candidates.from_bank(bank)
    pair = random_pair()
    torch.set_num_threads(1)
    Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
    before, seconds = _bytes("VmRSS"), []
    for _ in range(2 if len(candidates.poses) < 100_000 else 1):
        start = time.process_time()
        with torch.no_grad():
            score_candidates(*pair, candidates)
        seconds.append(time.process_time() - start)
        if len(seconds) == 1:
            peak = _bytes("VmHWM") - before
    print(json.dumps({"seconds": seconds, "peak_bytes": peak}))


if __name__ == "__main__":
    main(sys.argv[1])
