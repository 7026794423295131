"""A process that does something else meanwhile, whatever becomes of it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from piezo_rig.forked import Forked, worth_it

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")


def test_what_it_writes_is_found_and_no_process_is_left():
    with Forked(lambda out: out.write(b"here" * 100_000) and None) as other:
        pid = other._pid
        assert other.found() == b"here" * 100_000
    with pytest.raises(ChildProcessError):
        os.waitpid(pid, os.WNOHANG)


def test_one_that_fails_is_not_heard_of():
    def fails(out):
        out.write(b"half")
        raise RuntimeError

    with Forked(fails) as other:
        assert other.found() in (b"", b"half")


def test_it_is_killed_where_this_process_fails_meanwhile():
    def for_ever(_):
        while True:
            pass

    begun = []

    def stopped():
        with Forked(for_ever) as other:
            begun.append(other._pid)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    with pytest.raises(ChildProcessError):
        os.waitpid(begun[0], os.WNOHANG)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux only")
def test_it_is_not_worth_it_on_one_processor_nor_beside_threads():
    ask = "from piezo_rig.forked import worth_it; print(worth_it())"
    alone = f"import os; os.sched_setaffinity(0, {{min(os.sched_getaffinity(0))}}); {ask}"
    beside = f"import threading; threading.Timer(5, print).start(); {ask}; import os; os._exit(0)"
    for code in (alone, beside):
        told = subprocess.run([sys.executable, "-uc", code], capture_output=True, text=True)
        assert told.stdout == "False\n", told.stderr
    assert worth_it() in (True, False)
