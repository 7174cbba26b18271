"""Parts of work on Dask: equal to one process, whatever happens to the workers."""

import os
import signal
import threading
import time

import pytest
from slicematch.errors import ConfigError, RunError
from slicematch.parts import Parts, run_parts, split_groups

distributed = pytest.importorskip("distributed")


class Squares:
    """Work that takes a moment, and says who did it."""

    columns = {"number": "int64", "square": "int64"}  # noqa: RUF012

    def __init__(self, folder, seconds=0.0):
        self.folder = folder
        self.seconds = seconds

    def __call__(self, items):
        for item in items:
            with (self.folder / f"{item}-{time.monotonic_ns()}").open("w") as file:
                file.write(str(os.getpid()))
            time.sleep(self.seconds)
        return [{"number": item, "square": item * item} for item in items]


class Broken(Squares):
    def __call__(self, items):
        raise RunError("the work is broken")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="ERROR"
    ) as made:
        yield made


def bytes_of(parts):
    return {path.name: path.read_bytes() for path in sorted(parts.folder.glob("*.parquet"))}


GROUPS = [[3 * n, 3 * n + 1, 3 * n + 2] for n in range(12)]
SQUARES = [number * number for number in range(36)]


def test_two_workers_write_what_one_process_writes(cluster, tmp_path):
    (tmp_path / "log").mkdir()
    work = Squares(tmp_path / "log", 0.02)
    alone, together = Parts(tmp_path / "a", {}), Parts(tmp_path / "b", {})
    seen = []
    table = run_parts(work, alone, GROUPS)
    again = run_parts(
        work, together, GROUPS, cluster.scheduler_address, lambda *done: seen.append(done)
    )
    assert table["square"].to_pylist() == again["square"].to_pylist() == SQUARES
    assert bytes_of(alone) == bytes_of(together)
    assert len(bytes_of(alone)) == 12
    assert seen == [(count, 36) for count in range(0, 37, 3)]
    workers = {path.read_text() for path in (tmp_path / "log").iterdir()} - {str(os.getpid())}
    assert len(workers) == 2


def test_a_worker_that_is_killed_costs_no_row_and_doubles_none(cluster, tmp_path):
    (tmp_path / "log").mkdir()
    killed = []

    def kill_one():
        while not killed:
            started = sorted((tmp_path / "log").iterdir())
            if len(started) >= 8:
                process = int(started[-1].read_text() or 0)
                if process:
                    os.kill(process, signal.SIGKILL)
                    killed.append(process)
            time.sleep(0.01)

    thread = threading.Thread(target=kill_one)
    thread.start()
    parts = Parts(tmp_path / "parts", {})
    table = run_parts(Squares(tmp_path / "log", 0.1), parts, GROUPS, cluster.scheduler_address)
    thread.join()
    assert len(killed) == 1
    assert table["number"].to_pylist() == list(range(36))
    assert table["square"].to_pylist() == SQUARES
    assert not list(parts.folder.glob(".*"))  # the half-written file of the killed one, if any
    # What it had begun, or had not reported yet, was done again, and nothing else.
    begun = [path.name.split("-")[0] for path in (tmp_path / "log").iterdir()]
    assert 36 < len(begun) <= 42


def test_parts_that_are_there_are_not_done_again(cluster, tmp_path):
    (tmp_path / "log").mkdir()
    parts = Parts(tmp_path / "parts", {"a": 1})
    run_parts(Squares(tmp_path / "log"), parts, GROUPS)
    parts.path(5).unlink()
    run_parts(Squares(tmp_path / "log"), Parts(tmp_path / "parts", {"a": 1}), GROUPS, "1")
    begun = [int(path.name.split("-")[0]) for path in (tmp_path / "log").iterdir()]
    assert sorted(begun) == sorted([*range(36), 15, 16, 17])
    with pytest.raises(RunError, match="parts of another request, with a 1 in place of 2"):
        Parts(tmp_path / "parts", {"a": 2})


def test_an_error_of_the_work_is_the_caller_s(cluster, tmp_path):
    with pytest.raises(RunError, match=r"^the work is broken$"):
        run_parts(
            Broken(tmp_path), Parts(tmp_path / "parts", {}), GROUPS, cluster.scheduler_address
        )


def test_clusters_that_are_none(tmp_path, monkeypatch):
    parts = Parts(tmp_path / "parts", {})
    with pytest.raises(ConfigError, match="dask is '0'; it must be local, a number of processes"):
        run_parts(Squares(tmp_path), parts, GROUPS, "0")
    monkeypatch.setattr("slicematch.cluster._WAIT_S", 1)
    with pytest.raises(ConfigError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:1'"):
        run_parts(Squares(tmp_path), parts, GROUPS, "tcp://127.0.0.1:1")
    with (
        distributed.LocalCluster(
            n_workers=0, dashboard_address=None, silence_logs="ERROR"
        ) as empty,
        pytest.raises(ConfigError, match=r"no worker has come to 'tcp://.*' within 1 s"),
    ):
        run_parts(Squares(tmp_path), parts, GROUPS, empty.scheduler_address)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match="holds something else; move it away"):
        Parts(tmp_path, {})
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_parts_are_of_a_good_size():
    groups = [[0] * size for size in (1, 500, 3, 3, 70)]
    parts = split_groups(groups)
    assert sum(map(len, parts)) == 577
    assert max(map(len, parts)) <= 10  # at least 64 parts, for as many processes
    assert split_groups([]) == []
    assert max(map(len, split_groups([[0]] * 10**5))) == 64
