"""The same on a Dask cluster that somebody else has started.

The workers need this program and the same paths as this computer; the outputs come back and are
written here. A cluster that goes away leaves what was done.
"""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from piezo_rig import __version__
from piezo_rig.errors import BenchError, InputError
from piezo_rig.fleet.item import Item
from piezo_rig.fleet.local import DEADLINE_S
from piezo_rig.fleet.work import Outcome, Work, failed

ANSWER_S = 5.0  # for a scheduler to answer


def on_cluster(address: str, work: Work, items: Sequence[Item]) -> Iterator[Outcome]:
    """The outcomes, in the order in which they are ready.

    Raises
    ------
    InputError : the extra is not installed, or the address is none
    BenchError : no scheduler answers, it has no workers, a worker has another version of this
        program, or the scheduler goes away
    """
    # Dask tells its own log what went wrong, long after it is over too. Here it is said in words.
    logging.disable(logging.CRITICAL)
    _look(address)
    with _client(address) as client:
        ready: queue.SimpleQueue[Any] = queue.SimpleQueue()
        outstanding: dict[str, tuple[Any, Item]] = {}
        for item in items:
            future = client.submit(replace(work, elsewhere=True), item, pure=False)
            outstanding[future.key] = (future, item)
            future.add_done_callback(ready.put)
        latest = time.monotonic()
        while outstanding:
            try:
                future = ready.get(timeout=1.0)
            except queue.Empty:
                if client.status != "running":
                    raise _lost(address) from None
                if time.monotonic() - latest > DEADLINE_S:
                    for _, item in outstanding.values():
                        yield failed(item, InputError(
                            "timeout", f"{item.given}: the cluster finished nothing in "
                            f"{DEADLINE_S:g} s", "workers that stand still, or none are left",
                            "look at the cluster; the same command goes on",
                        ))  # fmt: skip
                    return
                continue
            latest = time.monotonic()
            _, item = outstanding.pop(future.key)
            if future.status in ("cancelled", "lost"):
                raise _lost(address)
            yield future.result() if future.status == "finished" else _died(future, item)
            future.release()


def _look(address: str) -> None:
    """See that a scheduler is there, before a client is made that takes long to give up."""
    import asyncio

    try:
        from distributed import rpc
    except ImportError:
        raise InputError(
            "not-installed", "--scheduler: Dask is not installed",
            "it is an optional extra", "pip install 'piezo-rig[cluster]'",
        ) from None

    async def identity() -> dict[str, Any]:
        async with rpc(address, timeout=ANSWER_S) as scheduler:
            said: dict[str, Any] = await asyncio.wait_for(scheduler.identity(), ANSWER_S)
            return said

    try:
        said = asyncio.run(identity())
    except ValueError as error:
        raise InputError("usage", f"--scheduler {address}: {error}", "a slip in the address",
                         "an address reads tcp://HOST:8786") from None
    except OSError:
        raise BenchError(
            "no-scheduler", f"no Dask scheduler answers at {address}",
            "it does not run, has another address, or a firewall is between",
            "start it with 'dask scheduler', or leave --scheduler out",
        ) from None
    if said.get("type") != "Scheduler":
        raise BenchError("no-scheduler", f"{address} is a Dask {said.get('type', 'thing')}, not a "
                         "scheduler", "a worker's address", "give the scheduler's")
    if not said.get("workers"):
        raise BenchError("no-workers", f"the scheduler at {address} has no workers",
                         "none were started, or they cannot reach it",
                         f"start some with 'dask worker {address} --nthreads 1'")


@contextmanager
def _client(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except OSError:
        raise _lost(address) from None
    try:
        _same_program(client, address)
        yield client
    finally:
        client.close(timeout=1)


def _same_program(client: Any, address: str) -> None:
    """Every worker can do the work, and would do it as it is done here."""
    try:
        found = client.run(version)
    except Exception as error:  # whatever a worker says that cannot import the program
        raise BenchError("no-program", f"{address}: a worker cannot use piezo-rig: {error}",
                         "it is not installed there", "install it on every worker") from None
    for worker, said in sorted(found.items()):
        if said != __version__:
            raise BenchError("other-version", f"the worker {worker} has piezo-rig {said}, this is "
                             f"{__version__}", "an update that did not reach all computers",
                             "install one version on all of them")


def version() -> str:
    """The version of this program where this is called."""
    return __version__


def _died(future: Any, item: Item) -> Outcome:
    error = future.exception()
    return failed(item, InputError(
        "worker-died", f"{item.given}: the cluster gave up on it: {type(error).__name__}",
        "the workers that took it ended: too little memory, or a file that a library does not "
        "survive", "analyse this file by itself; see 'piezo-rig verify'",
    ))  # fmt: skip


def _lost(address: str) -> BenchError:
    return BenchError("cluster-lost", f"the scheduler at {address} went away",
                      "it was stopped, or the network failed",
                      "give the same command again, with or without --scheduler: it goes on with "
                      "what is missing")
