"""What every cause looks like and what it is taken for: writes docs/causes.md.

    python -m piezo_rig.studies.causes

The words are those of the causes' own files. The figures are computed: an example of every cause
is played through the shipped `thesis_classical` model under shipped protocols, what a refit of
the base model would make of it (play operators, powers of the drive, an offset per sweep) is
taken off, and what is left is compared.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES, load_model
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import Model, Stage, half_loops
from piezo_rig.config import DEFAULT_RIG, load_rig
from piezo_rig.diagnosis.grouping import LOOKED_BACK
from piezo_rig.diagnosis.groups import Group
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import find
from piezo_rig.studies.document import table

FloatArray = NDArray[np.float64]
PROTOCOLS = ("thesis_matrix", "shuffled_matrix", "rate_sweep", "hold_steps", "minor_loops")
RATE, PER_SECOND, NOISE_UM = 1000.0, 5000.0, 2e-3
LIKE, MOST = 0.8, 5  # cosines that are listed, and how many
PLAYS, POWERS = 40, 5
CUT, SAME = 1e-10, 1e-3  # eigenvalues that count, singular values that count
BEGIN = "<!-- computed by `make study-causes` -->"

HEAD = """# The causes, one by one

The words are those of the files in `piezo_rig/causes`, one cause each (`make docs` takes them
over). The tables are computed by `make study-causes`: a small example of each cause is played
through the shipped model `thesis_classical` under shipped protocols, what a refit of the base
model would make of it is taken off, and the rest is compared. *d'* is the length of that rest in
white noise of 2 nm at 5 kSa/s, one repeat: with ten times the example it is ten times as large. A
cosine of 1 is the same signature. Causes are told apart where d' sqrt(1 - cosine^2) is 4 or more;
a diagnosis computes this anew from the data at hand, with their own noise. Drive gain and sensor
scale are compared as against a fixed model, nothing taken off but an offset per sweep. `input-bend`
and `output-bend` run in the same race, but belong to the base model: a diagnosis never names them.
"""


def words(id: str) -> str:
    """What a cause's own file says of it, as Markdown."""
    module = inspect.getmodule(CAUSES[id])
    text = inspect.cleandoc((module.__doc__ if module else "") or "")
    title, _, rest = text.partition("\n\n")
    kind = CAUSES[id]
    named = ", ".join(f"`{n}` ({u})" if u != "1" else f"`{n}`" for n, u in kind.units.items())
    reported = f"Place: {kind.place}. Reported: {named or 'no parameters'}."
    return f"## {id}\n\n{' '.join(title.split())}\n\n{rest}\n\n{reported}"


def page(computed: dict[str, str]) -> str:
    """The whole page from the tables of every cause."""
    parts = [f"{words(id)}\n\n{BEGIN}\n\n{computed.get(id, '')}".rstrip() for id in CAUSES]
    return HEAD + "\n" + "\n\n".join(parts) + "\n"


def computed_of(text: str) -> dict[str, str]:
    """The tables that a page holds."""
    out = {}
    for part in text.split("\n## ")[1:]:
        id = part.split("\n", 1)[0].strip()
        out[id] = part.split(BEGIN, 1)[1].strip() if BEGIN in part else ""
    return out


def played(name: str) -> list[Group]:
    """Every condition of a shipped protocol once, at a kilohertz, each after those before it."""
    plan = build_plan(load_protocol(find("protocols", name)), load_rig(DEFAULT_RIG))
    step = max(1, round(plan.sample_rate / RATE))
    out: list[Group] = []
    turns: list[FloatArray] = []
    for condition, wave in plan.conditions():
        drive = np.ascontiguousarray(wave.drive_v[::step])
        if np.ptp(drive) == 0.0:
            continue
        time = np.arange(drive.size) * step / plan.sample_rate
        loops = half_loops(drive)
        out.append(Group(
            time, drive, np.zeros((1, drive.size)), np.zeros(1), "virgin", ((0, drive.size),),
            loops, condition.name, ((0,),), ((1.0, tuple(turns[-LOOKED_BACK:])),),
        ))  # fmt: skip
        turns.append(drive[np.append(loops.start, drive.size - 1)])
    return out


def context_of(groups: Sequence[Group], model: Model) -> Context:
    slews, travel, ends = [], 0.0, []
    for g in groups:
        seconds = g.time_s[g.loops.stop] - g.time_s[g.loops.start]
        volts = np.abs(g.drive_v[g.loops.stop] - g.drive_v[g.loops.start])
        slews.append(volts[seconds > 0] / seconds[seconds > 0])
        moved = g.predicted(model) - g.predicted(model)[0]
        travel = max(travel, float(np.ptp(moved)))
        ends += [float(moved.min()), float(moved.max())]
    span = max(float(np.ptp(g.drive_v)) for g in groups)
    longest = max(float(g.time_s[-1]) for g in groups)
    step = float(groups[0].time_s[1])
    low, high = min(g.drive_v.min() for g in groups), max(g.drive_v.max() for g in groups)
    return Context(
        model, travel, span, np.concatenate(slews), step, longest, RATE,
        ends_v=(float(low), float(high)), ends_um=(min(ends), max(ends)),
    )  # fmt: skip


class Compared:
    """Examples of all causes under one protocol, as one Gram matrix."""

    def __init__(self, name: str, model: Model) -> None:
        groups = played(name)
        context = context_of(groups, model)
        self.step_s = context.step_s
        self.forms: dict[str, list[list[int]]] = {}
        self._said: list[str] = []
        trials: list[Stage] = []
        for id, kind in CAUSES.items():
            assert issubclass(kind, Cause)
            for form in kind.variants(context):
                self.forms.setdefault(id, []).append(
                    list(range(len(trials), len(trials) + len(form)))
                )
                trials += form
                self._said += [
                    ", ".join(f"{n} {t[n]:.4g} {u if u != '1' else ''}".strip()
                              for n, u in kind.units.items()) for t in form
                ]  # fmt: skip
        self.base = PLAYS + POWERS
        total = self.base + len(trials)
        self.gram = np.zeros((total, total))
        for g in groups:
            plain = g.predicted(model)
            rows = [*_base(g, context.span_v)]
            rows += [g.predicted(model.with_stage(t)) - plain for t in trials]
            columns = np.array(rows)
            columns -= columns.mean(axis=1, keepdims=True)
            self.gram += columns @ columns.T
        own = self.gram[: self.base, : self.base]
        size = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
        value, vector = np.linalg.eigh(own * np.outer(size, size))
        good = value > CUT * value[-1]
        half = (vector[:, good] / np.sqrt(value[good])).T * size
        cross = half @ self.gram[: self.base, self.base :]
        self.plain = self.gram[self.base :, self.base :]
        self.left = self.plain - cross.T @ cross

    def example(self, id: str) -> str:
        """Parameters of the example that is shown; empty where it has none."""
        return self._said[self.shown(id)]

    def gram_of(self, id: str) -> FloatArray:
        kind = CAUSES[id]
        assert issubclass(kind, Cause)
        return self.plain if kind.needs_fixed_model else self.left

    def shown(self, id: str) -> int:
        """The example that shows best; of a cause that may last the one of a typical length."""
        kind, gram = CAUSES[id], self.gram_of(id)
        lasts = issubclass(kind, Cause) and kind.lasting
        forms = self.forms[id][:1] if lasts else self.forms[id]
        return max((k for form in forms for k in form), key=lambda k: float(gram[k, k]))

    def d_prime(self, id: str) -> float:
        """Of the example that is shown."""
        k, gram = self.shown(id), self.gram_of(id)
        return float(np.sqrt(max(gram[k, k], 0.0) * PER_SECOND * self.step_s) / NOISE_UM)

    def cosines(self, id: str) -> dict[str, float]:
        """With what every other cause can do."""
        gram, k = self.gram_of(id), self.shown(id)
        out = {}
        for other, forms in self.forms.items():
            kind = CAUSES[other]
            assert issubclass(kind, Cause)
            if other == id or (kind.needs_fixed_model and gram is self.left):
                continue
            out[other] = max(_cosine(gram, k, form) for form in forms)
        return out


def _base(group: Group, span_v: float) -> FloatArray:
    from piezo_rig.diagnosis.dictionary import _plays

    thresholds = 0.5 * span_v * np.arange(PLAYS) / PLAYS
    plays = _plays(group.drive_v, thresholds)
    u = group.drive_v / span_v
    return np.concatenate([plays, [u**p for p in range(1, POWERS + 1)]])


def _cosine(gram: FloatArray, k: int, form: Sequence[int]) -> float:
    size = np.sqrt(np.maximum(np.diag(gram)[list(form)], 0.0))
    if not np.all(size > 0.0) or not gram[k, k] > 0.0:
        return 0.0
    own = gram[np.ix_(form, form)] / np.outer(size, size)
    value, vector = np.linalg.eigh(own)
    good = value > SAME**2 * value[-1]
    inside = (vector[:, good] / np.sqrt(value[good])).T @ (gram[list(form), k] / size)
    return float(min(np.sqrt(inside @ inside / gram[k, k]), 1.0))


def tables() -> dict[str, str]:
    """A table for every cause that can be played."""
    model = load_model(find("models", "thesis_classical"))
    every = {name: Compared(name, model) for name in PROTOCOLS}
    out = {}
    for id in CAUSES:
        first = every[PROTOCOLS[0]]
        if id not in first.forms:
            out[id] = ("Sought in the single recordings: it repeats with no drive, and is compared "
                       "with nothing here.")  # fmt: skip
            continue
        rows = []
        for name, compared in every.items():
            cosines = compared.cosines(id)
            like = sorted((c for c in cosines if cosines[c] >= LIKE), key=lambda c: -cosines[c])
            said = ", ".join(f"{c} {cosines[c]:.2f}" for c in like[:MOST]) or "-"
            rows.append((f"`{name}`", f"{compared.d_prime(id):.1f}", said))
        example = first.example(id) or "a first rise that differs by 1 %"
        out[id] = f"Example: {example}.\n\n" + table(("protocol", "d'", "much like"), rows)
    return out


def main() -> None:
    Path("docs/causes.md").write_text(page(tables()), encoding="utf-8")
    print("docs/causes.md")


if __name__ == "__main__":
    main()
