"""Processes and a cluster that do the work, and what happens when they do not."""

from __future__ import annotations

import logging
import socket
import sys
from contextlib import nullcontext
from dataclasses import dataclass

import pytest
from odd_work import half, odd

from piezo_rig.errors import BenchError, InputError
from piezo_rig.fleet import Item, Work, cluster
from piezo_rig.fleet.local import on_this_computer


@pytest.fixture(autouse=True)
def log_as_before():
    yield
    logging.disable(logging.NOTSET)


def item(name, *files):
    return Item(name, f"{name}.h5", tuple(map(str, files)))


def test_a_process_that_dies_takes_one_file_with_it():
    names = ["a", "exits", "b", "killed", "c"]
    found = {o.name: o for o in on_this_computer(odd, [item(n) for n in names], workers=1)}
    assert {n for n, o in found.items() if not o.error} == {"a", "b", "c"}
    assert found["exits"].code == found["killed"].code == "worker-died"
    assert "exit status 9" in found["exits"].error
    assert "SIGKILL" in found["killed"].error
    assert "killed.h5" in found["killed"].text


def test_a_file_that_takes_for_ever_has_failed_and_its_process_is_ended():
    (found,) = on_this_computer(odd, [item("hangs")], workers=1, deadline_s=0.0)
    assert found.code == "timeout"


def test_work_brings_back_outputs_assumptions_and_errors(tmp_path):
    good, bad = tmp_path / "good.csv", tmp_path / "bad.csv"
    good.write_text("5")
    bad.write_text("five")
    done = Work(half)(item("good", good))
    assert done.row["rms_nm"] == 2.5
    assert done.files == {".json": b"2.5"}
    assert done.said == ("assumed: it is a number",)
    assert Work(half)(Item("good", "g", (str(good),), done.sha256)).unchanged
    failure = Work(half)(item("bad", bad))
    assert failure.code == "internal"
    assert "five" in failure.error
    assert Work(half)(item("none", tmp_path / "none")).code == "not-found"
    assert Work(half)(item("empty")).code == "no-data"


@pytest.fixture
def scheduler():
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                      protocol="tcp", host="127.0.0.1") as local:  # fmt: skip
        yield local


def test_a_cluster_does_the_same_and_says_what_its_workers_cannot_see(tmp_path, scheduler):
    (tmp_path / "good.csv").write_text("5")
    items = [item("good", tmp_path / "good.csv"), item("gone", tmp_path / "gone.csv")]
    found = {o.name: o for o in cluster.on_cluster(scheduler.scheduler_address, Work(half), items)}
    assert found["good"].files == {".json": b"2.5"}
    assert found["gone"].code == "not-visible"
    assert "share" in found["gone"].error
    worker = next(iter(scheduler.scheduler_info["workers"]))
    with pytest.raises(BenchError) as caught:
        list(cluster.on_cluster(worker, Work(half), items))
    assert caught.value.code == "no-scheduler"


class LostClient:
    """A Dask client as it is when the scheduler goes away after the first file."""

    status = "connecting"

    def __init__(self):
        self.submitted = 0

    def submit(self, work, item, pure):
        self.submitted += 1
        return LostFuture(work(item), item.name, "finished" if self.submitted == 1 else "cancelled")


@dataclass
class LostFuture:
    outcome: object
    key: str
    status: str

    def add_done_callback(self, tell):
        tell(self)

    def result(self):
        return self.outcome

    def release(self):
        pass


def test_a_cluster_that_goes_away_is_an_error_and_keeps_what_came(tmp_path, monkeypatch):
    paths = [tmp_path / f"{n}.csv" for n in range(3)]
    for path in paths:
        path.write_text("5")
    monkeypatch.setattr(cluster, "_look", lambda address: None)
    monkeypatch.setattr(cluster, "_client", lambda address: nullcontext(LostClient()))
    came = cluster.on_cluster("host:1", Work(half), [item(p.stem, p) for p in paths])
    assert next(came).row["rms_nm"] == 2.5
    with pytest.raises(BenchError) as caught:
        next(came)
    assert caught.value.code == "cluster-lost"
    assert caught.value.exit_status == 4


def test_a_scheduler_that_does_not_answer_is_said_at_once(monkeypatch):
    monkeypatch.setattr(cluster, "ANSWER_S", 0.1)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        for port in (silent.getsockname()[1], 1):
            with pytest.raises(BenchError) as caught:
                list(cluster.on_cluster(f"127.0.0.1:{port}", Work(half), [item("a")]))
            assert caught.value.code == "no-scheduler"
            assert caught.value.exit_status == 4
    with pytest.raises(InputError, match="nonsense"):
        list(cluster.on_cluster("nonsense", Work(half), [item("a")]))


def test_a_cluster_without_dask_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="not installed") as caught:
        list(cluster.on_cluster("127.0.0.1:1", Work(half), [item("a")]))
    assert "piezo-rig[cluster]" in caught.value.remedy
