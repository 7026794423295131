"""An end to trying: what no cause explains is not tried on all of them without end."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.patience import AT_ALL, WAYS_ROUND, Patience
from piezo_rig.errors import InputError
from tests.diagnosis.small_bench import CONDITIONS, recordings


def test_first_ways_round_and_then_everything_comes_to_an_end():
    patience = Patience()
    assert not patience.lost
    assert patience.note is None
    patience.spend(WAYS_ROUND)
    assert patience.lost
    assert not patience.at_an_end
    assert str(WAYS_ROUND) in patience.note
    patience.spend(AT_ALL - WAYS_ROUND)
    assert patience.at_an_end


def test_a_climb_that_begins_anew_is_not_at_an_end():
    """It has no ways round where all climbs together had tried as much as one may."""
    patience = Patience()
    patience.spend(WAYS_ROUND)
    patience.begin()
    assert not patience.lost
    patience.spend(AT_ALL - WAYS_ROUND - 1)
    assert not patience.lost
    patience.spend(1)
    assert patience.lost
    patience.begin()
    assert patience.lost
    assert not patience.at_an_end


def waving(x, drive, t):
    """Waves of the drive that turn their sign with its direction: no cause of the catalogue."""
    return x + 0.02 * np.tanh(np.gradient(drive) / 0.05) * np.sin(0.4 * drive)


@pytest.mark.study
def test_without_patience_what_is_left_is_said(monkeypatch):
    monkeypatch.setattr(Patience, "lost", property(lambda self: True))
    monkeypatch.setattr(Patience, "at_an_end", property(lambda self: True))
    found = diagnose(recordings(effect=waving))
    assert found.findings == []
    assert found.unexplained.detected
    assert any("no further ways round" in note for note in found.notes)


def test_a_law_that_holds_no_more_ends_a_climb_and_not_the_diagnosis(monkeypatch):
    """Its findings up to there are said, and why there are no more."""
    real, words = Search.take, "the first slope of half loop 142 is -0.195 V/um"

    def take(self, *args):
        if self.causes:
            raise InputError("slope-not-positive", words)
        return real(self, *args)

    monkeypatch.setattr(Search, "take", take)

    def late(x, drive, t):
        return np.interp(t - 3e-4, t, x) + 0.01 * np.sin(2.0 * np.pi * x / 0.3164)

    found = diagnose(recordings(effect=late, conditions=CONDITIONS[1:3]))
    assert found.findings
    assert any(words in note for note in found.notes)


@pytest.mark.parametrize("tried", [0, WAYS_ROUND - 1])
def test_what_is_found_soon_has_no_such_note(tried):
    patience = Patience()
    patience.spend(tried)
    assert patience.note is None
