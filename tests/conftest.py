"""What tests share: where the reference data is, and the simulated rig."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

import piezo_rig  # noqa: F401  before numpy: it keeps BLAS to one thread

settings.register_profile("same", derandomize=True, deadline=None)  # kernels compile at first use
settings.load_profile("same")  # the same examples every time; `--hypothesis-profile` for others

CHECKOUT = Path(__file__).resolve().parent.parent


LONGEST = "test_diagnosis_of_real_recordings.py"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest comes first, or one of two workers waits for it at the end."""
    items.sort(key=lambda item: item.path.name != LONGEST)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The reference data beside the checkout; a user's clone does not have it."""
    folder = Path(os.environ.get("PIEZO_RIG_SHARED", CHECKOUT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip("the reference data is not here")
    return folder
