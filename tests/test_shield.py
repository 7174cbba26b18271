"""Work that Ctrl-C does not tear apart."""

import os
import signal
import threading
import time

import pytest

from slicemask.shield import shielded


def test_the_work_s_result_and_its_error_come_out():
    assert shielded(lambda check: 5) == 5
    with pytest.raises(ZeroDivisionError):
        shielded(lambda check: 1 / 0)


def test_an_interrupt_is_raised_when_the_work_has_stopped():
    ended = []

    def work(check):
        os.kill(os.getpid(), signal.SIGINT)
        try:
            while True:
                time.sleep(0.01)
                check()
        finally:
            time.sleep(0.2)
            ended.append(True)

    with pytest.raises(KeyboardInterrupt):
        shielded(work)
    assert ended == [True]


def test_an_interrupt_that_comes_too_late_is_raised_all_the_same():
    def work(check):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)
        return 5

    with pytest.raises(KeyboardInterrupt):
        shielded(work)


def test_it_works_away_from_the_main_thread():
    results = []
    thread = threading.Thread(target=lambda: results.append(shielded(lambda check: 5)))
    thread.start()
    thread.join()
    assert results == [5]
