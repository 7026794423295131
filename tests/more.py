"""More of the same for the study: of many cases the first few are for every time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def first_of(now: int, cases: Iterable[Any]) -> list[Any]:
    """Cases for ``parametrize``: the first ``now`` as they are, the others for the study."""
    cases = list(cases)
    study = [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.study)
        for case in cases[now:]
    ]
    return [*cases[:now], *study]
