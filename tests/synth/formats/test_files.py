"""Which pictures of a generated data set are complete."""

import os
import resource
from contextlib import suppress

import numpy as np
import pytest

from slicemask.synth.formats.files import is_complete, write_picture


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_picture_that_was_cut_short_is_not_complete(tmp_path, suffix):
    path = tmp_path / f"picture{suffix}"
    assert not is_complete(path, (40, 20))
    write_picture(path, np.full((20, 40, 3), 90, np.uint8))
    assert is_complete(path, (40, 20))
    assert not is_complete(path, (20, 40))
    content = path.read_bytes()
    for kept in (0, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:kept])
        assert not is_complete(path, (40, 20))


def test_running_out_of_open_files_makes_no_picture_incomplete(tmp_path):
    path = tmp_path / "picture.png"
    write_picture(path, np.zeros((20, 40, 3), np.uint8))
    assert is_complete(path, (40, 20))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    held = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 256), hard))
    try:
        with suppress(OSError):
            while True:
                held.append(os.open(path, os.O_RDONLY))
        with pytest.raises(OSError, match="Too many open files"):
            is_complete(path, (40, 20))
    finally:
        for file in held:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
