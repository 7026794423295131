"""The catalogue: causes are found by file and keep the design's names."""

from __future__ import annotations

from pathlib import Path

import pytest

import piezo_rig.causes
from piezo_rig.causes import CAUSES, NAMED_MODELS, named_model
from piezo_rig.causes.cause import Cause
from piezo_rig.chain.stage import PLACES
from piezo_rig.errors import InputError


def test_every_file_holds_the_cause_that_it_is_named_after():
    folder = Path(piezo_rig.causes.__file__).parent
    others = {"--init--", "catalogue", "cause", "first-spring"}
    files = {p.stem.replace("_", "-") for p in folder.glob("*.py")} - others
    assert set(CAUSES) == files


def test_causes_say_where_they_are_and_in_which_units():
    for id, kind in CAUSES.items():
        assert kind.id == id
        assert kind.place in PLACES
        assert kind.locked_to in ("drive", "clock")
        assert set(kind.neutral) <= {*kind.units, *kind.optional}
        assert kind.__module__.rsplit(".", 1)[1].replace("_", "-") == id


def test_every_number_that_a_report_may_show_says_what_it_is():
    for kind in CAUSES.values():
        assert issubclass(kind, Cause)
        for name in (*kind.units, *kind.optional):
            assert kind.meanings.get(name), f"{kind.id}: {name}"


def test_named_models_are_lists_of_causes():
    for name, ids in NAMED_MODELS.items():
        assert tuple(k.id for k in named_model(name)) == ids
    with pytest.raises(InputError, match="magic"):
        named_model("magic")
