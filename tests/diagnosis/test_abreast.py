"""Steps done by two processes give what they give one after the other."""

from __future__ import annotations

import os
import sys
import threading
from dataclasses import dataclass, field

import pytest

from piezo_rig.diagnosis import abreast as room
from piezo_rig.diagnosis.abreast import abreast, alone
from piezo_rig.errors import InputError


@dataclass(eq=False)
class Counted:
    """A space that a step changes."""

    seen: list[int] = field(default_factory=list)

    def state(self):
        return {"seen": list(self.seen)}

    def restore(self, state):
        self.seen = state["seen"]

    def put(self, value: int) -> list[int]:
        self.seen.append(value)
        return list(self.seen)


@dataclass(eq=False)
class Thing:
    of: Counted


@pytest.fixture(params=[True, False], ids=["two processes", "one process"])
def two(request, monkeypatch) -> bool:
    if request.param and not hasattr(os, "fork"):
        pytest.skip("no fork here")
    monkeypatch.setattr(room, "worth_it", lambda: request.param)
    return request.param


def test_every_step_begins_with_the_space_as_it_is_and_leaves_it_so(two):
    space = Counted([7])
    found = abreast(space, [lambda k=k: space.put(k) for k in range(9)])
    assert found == [[7, k] for k in range(9)]
    assert space.seen == [7]


def test_known_objects_come_back_as_themselves(two):
    space = Counted()
    here = Thing(space)
    found = abreast(space, [lambda: (here, Thing(space))] * 4, [here])
    assert all(known is here and made.of is space for known, made in found)


@pytest.fixture
def forking(monkeypatch):
    if not sys.platform.startswith("linux"):
        pytest.skip("Linux only")
    monkeypatch.setattr(room, "worth_it", lambda: True)


def test_a_second_process_takes_part(forking):
    waits = threading.Event()

    def step():
        before = alone()
        waits.wait(0.1)
        return os.getpid(), before

    found = abreast(Counted(), [step] * 4)
    assert len({pid for pid, _ in found}) == 2
    assert not all(before for _, before in found)
    assert alone()


def test_a_process_that_has_done_its_part_is_there_for_steps_of_the_other(forking):
    waits = threading.Event()

    def quick():
        return []

    def long():
        waits.wait(0.3)  # until the quick one is done
        return abreast(Counted(), [lambda: (waits.wait(0.2), os.getpid())[1]] * 2)

    for steps in ([long, quick], [quick, long]):  # in this process, and in the other one
        inner = max(abreast(Counted(), steps), key=len)
        assert len(set(inner)) == 2
        assert alone()


def test_steps_of_steps_are_done_where_they_are(two):
    space = Counted([1])

    def outer():
        space.put(2)
        return abreast(space, [lambda k=k: space.put(k) for k in (3, 4)])

    assert abreast(space, [outer, outer]) == [[[1, 2, 3], [1, 2, 4]]] * 2


def test_an_error_of_a_step_is_raised_and_no_process_is_left(two, monkeypatch):
    fork, begun = os.fork, []

    def counted():
        begun.append(fork())
        return begun[-1]

    monkeypatch.setattr(os, "fork", counted)

    def step(k):
        if k % 2:
            raise InputError("rates-disagree", "no")
        return k

    with pytest.raises(InputError):
        abreast(Counted(), [lambda k=k: step(k) for k in range(6)])
    assert alone()
    assert len(begun) == (1 if two else 0)
    for pid in begun:
        with pytest.raises(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)


def test_what_a_process_that_dies_had_begun_is_done_all_the_same(monkeypatch):
    if not hasattr(os, "fork"):
        pytest.skip("no fork here")
    monkeypatch.setattr(room, "worth_it", lambda: True)
    here = os.getpid()

    def step(k):
        if os.getpid() != here:
            os._exit(9)
        return k

    assert abreast(Counted(), [lambda k=k: step(k) for k in range(5)]) == list(range(5))


def test_without_room_for_a_second_process_all_is_done_here(monkeypatch):
    def refused():
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(room, "worth_it", lambda: True)
    monkeypatch.setattr(os, "fork", refused, raising=False)
    space = Counted([7])
    assert abreast(space, [lambda k=k: space.put(k) for k in range(3)]) == [[7, 0], [7, 1], [7, 2]]
    assert alone()


def test_what_cannot_be_handed_over_is_done_here(monkeypatch):
    if not hasattr(os, "fork"):
        pytest.skip("no fork here")
    monkeypatch.setattr(room, "worth_it", lambda: True)
    found = abreast(Counted(), [lambda k=k: (lambda: k) for k in range(4)])
    assert [f() for f in found] == list(range(4))


def test_more_steps_than_a_byte_counts(two):
    assert abreast(Counted(), [lambda k=k: k for k in range(300)]) == list(range(300))
