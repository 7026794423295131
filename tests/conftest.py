"""What tests share: where the reference data is, and the simulated rig."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest
from hypothesis import settings

import piezo_rig  # noqa: F401  before numpy: it keeps BLAS to one thread

settings.register_profile("same", derandomize=True, deadline=None)  # kernels compile at first use
settings.load_profile("same")  # the same examples every time; `--hypothesis-profile` for others

CHECKOUT = Path(__file__).resolve().parent.parent


# files whose tests take seconds each, the longest first
LONGEST = (
    "test_findings.py", "test_given_that_lacks.py", "test_remanence.py", "test_breadth.py",
    "test_large_effects.py", "test_combinations.py", "test_reaches.py",
    "test_hidden_through_drivers.py", "test_diagnosis_of_real_recordings.py",
    "test_long_delays.py", "test_tutorial.py", "test_other_drives.py", "test_drive_monitor.py",
    "test_page.py", "test_uncertainty.py", "test_run.py", "test_guard.py",
)


def pytest_configure() -> None:
    """A processor for every worker: a diagnosis does not try to share one that is in use."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker.startswith("gw") and hasattr(os, "sched_setaffinity"):
        mine = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {mine[int(worker[2:]) % len(mine)]})
    gc.disable()  # what is imported stays: to go through it meanwhile is a quarter of the time


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest comes first, or one of two workers waits for it at the end."""
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The reference data beside the checkout; a user's clone does not have it."""
    folder = Path(os.environ.get("PIEZO_RIG_SHARED", CHECKOUT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip("the reference data is not here")
    return folder
