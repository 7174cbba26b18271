"""Frames as they come: the newest is worked on, and what is dropped is counted."""

import threading

import pytest
from slicematch.tracking.live import newest


def test_a_slow_worker_gets_the_newest_and_is_told_how_many_it_missed():
    begun, go_on, done = threading.Event(), threading.Event(), []

    def work(frame, dropped):
        done.append((frame, dropped))
        begun.set()
        assert go_on.wait(10)

    frames = newest(work)
    frames.put(0)
    assert begun.wait(10)
    for number in (1, 2, 3):
        frames.put(number)
    go_on.set()
    frames.close()
    assert done == [(0, 0), (3, 2)]


def test_an_error_of_the_worker_comes_back():
    def work(frame, dropped):
        raise ValueError(f"no {frame}")

    frames = newest(work)
    frames.put("frame")
    with pytest.raises(ValueError, match="no frame"):
        frames.close()
