"""Work that Ctrl-C does not tear apart."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from click.testing import CliRunner

from slicemask.cli.main import main
from slicemask.interrupts import exit_on_signals, run_cancellable


def test_the_work_s_result_and_its_error_come_out():
    assert run_cancellable(lambda check: 5) == 5
    with pytest.raises(ZeroDivisionError):
        run_cancellable(lambda check: 1 / 0)


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
        run_cancellable(work)
    assert ended == [True]


def test_more_interrupts_do_not_end_the_wait():
    ended = []

    def work(check):
        try:
            while True:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.02)
                check()
        finally:
            for _ in range(10):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.02)
            ended.append(True)

    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            run_cancellable(work)
    assert ended == [True] * 5


def test_an_interrupt_that_comes_too_late_is_raised_all_the_same():
    def work(check):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)
        return 5

    with pytest.raises(KeyboardInterrupt):
        run_cancellable(work)


def test_no_interrupt_is_lost_on_the_way_into_the_wait():
    # The signal comes while the main thread goes to wait for the work, each time elsewhere.
    late = []

    def work(check):
        os.kill(os.getpid(), signal.SIGINT)
        last = time.monotonic() + 5
        while time.monotonic() < last:
            time.sleep(0.0005)
            check()
        late.append(True)

    for _ in range(200):
        with pytest.raises(KeyboardInterrupt):
            run_cancellable(work)
    assert not late


def test_it_works_away_from_the_main_thread():
    results = []
    thread = threading.Thread(target=lambda: results.append(run_cancellable(lambda check: 5)))
    thread.start()
    thread.join()
    assert results == [5]


def handlers():
    return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]


@pytest.mark.parametrize(
    ("number", "error"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_signals_end_the_block_and_are_handled_as_before_after_it(number, error):
    before = handlers()

    def interrupted():
        with exit_on_signals():
            os.kill(os.getpid(), number)
            time.sleep(10)

    with pytest.raises(error):
        interrupted()
    assert handlers() == before
    with exit_on_signals():
        assert handlers() != before
    assert handlers() == before


def test_a_handler_of_the_caller_s_own_is_kept_and_restored():
    def own(number, frame):
        pass

    outer = {number: signal.signal(number, own) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with exit_on_signals():
            assert signal.getsignal(signal.SIGINT) is own
        assert handlers() == [own, own]
    finally:
        for number, handler in outer.items():
            signal.signal(number, handler)


def test_a_command_leaves_the_handlers_of_its_caller(tmp_path):
    before = handlers()
    out = str(tmp_path / "bank.h5")
    for arguments in (["build", "--grid", "1x1x2", "--out", out], ["info", "no.h5"]):
        CliRunner().invoke(main, arguments)
        assert handlers() == before


def test_away_from_the_main_thread_handlers_are_left_alone():
    errors = []

    def run():
        try:
            with exit_on_signals():
                pass
        except ValueError as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert errors == []


def test_a_signal_waits_until_an_import_is_done(tmp_path):
    (tmp_path / "swallows.py").write_text(
        "import os, signal, time\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    time.sleep(0.2)\n"
        "except BaseException:\n"
        "    pass\n"
    )
    code = (
        "import time\n"
        "from slicemask.interrupts import exit_on_signals\n"
        "with exit_on_signals():\n"
        "    import swallows\n"
        "    print('imported', flush=True)\n"
        "    time.sleep(60)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,  # not when the sleep is over
    )
    assert (ran.stdout, ran.stderr, ran.returncode) == ("imported\n", "", 128 + signal.SIGTERM)
