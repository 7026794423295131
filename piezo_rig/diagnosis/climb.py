"""The ladder: which causes the data ask for, one after the other.

Forward selection: every cause of the catalogue is scored against the refitted model; the best is
accepted if its family-wise chance is below `LEVEL`, the model is extended, refitted with all
parameters and linearised anew. Members that are no longer needed are dropped on the way; at the
end the ladder is climbed once more around members that others could stand in for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.bends import BEND, bend, with_own_bend
from piezo_rig.diagnosis.confusion import APART
from piezo_rig.diagnosis.detours import around, together
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.foretold import foretold, in_a_better_form
from piezo_rig.diagnosis.forms import converged, in_another_form, reached, summit
from piezo_rig.diagnosis.grown import FAR_BEHIND, Tried
from piezo_rig.diagnosis.held_springs import with_force_kept
from piezo_rig.diagnosis.in_doubt import explained
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.late import both, note_the_other, rather_the_other
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.own_laws import also, loosen, rather
from piezo_rig.diagnosis.patience import Patience
from piezo_rig.diagnosis.put_in import LARGE
from piezo_rig.diagnosis.race import raced, tried
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, gained, refit, settle
from piezo_rig.diagnosis.refusals import (
    BESIDE,
    CAME_TO_NOTHING,
    FITS,
    OF_THE_MISFIT,
    SAYS_NO_MORE,
    carrying,
    of_a_corner,
    of_a_law,
    worse,
)
from piezo_rig.diagnosis.scan import LATER, LEVEL, Found, Scan, has_reach, of_base, scan
from piezo_rig.diagnosis.scores import score_generic
from piezo_rig.diagnosis.shapes import in_another_shape
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import (
    NEEDED,
    clear,
    faint,
    far_off,
    idle,
    less_what_is_faint,
    one_by_one,
    prune,
)
from piezo_rig.diagnosis.twins import are_twins, foretelling_as_well
from piezo_rig.diagnosis.warmth import OF_WARMTH
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
MOST = 8  # findings
DOUBTFUL = 1e-6  # chance of a false alarm above which a cause must predict unseen data better
ROUNDS, FEW = 2, 3
AS_WELL = 1.0005  # held-out error of a rival, of that of what was taken: less is chance
# held-out error beside the noise, of that when a cause was refused, below which it is tried again
NEARER = 0.9
MUCH_NEARER = 0.5  # the same for one that came to nothing
# gain of a law let go of, of what any other cause would, while there is one; of what a table would
PLAINLY, OF_A_TABLE = 2.0, 0.3
FAR_LIKELIER = 0.7  # of its worth, that counts of a cause which is much like others
OF_A_BEND = 0.8  # worth of a bend, of that of a law, from which on it is the bend
NEARLY = 0.8  # worth of another law of the first spring, of that of one, from which it is doubted
OF_ANOTHERS = 0.5  # log-likelihood of a rival beside the member that was taken, of that before
MASKED = 0.5  # worth of a cause, of that of one which was refused for what it predicts
HOPE = 1.5  # times what the last step of a climb gained that each further one may gain
PAIR = 2  # causes, each gaining as much as the best by a linear look, that may do for a detour
# of what a member said, that the newest says at most where that one is not looked at once more
FAR_LESS = 0.1
Tell = Callable[[str], None]


def climb(
    space: Space,
    first: Fitted,
    rng: np.random.Generator,
    tell: Tell,
    held_out: Sequence[tuple[Callable[[Fitted], float], float]],
    noise_nm: float,
    others: int = 0,
    helps: Callable[..., bool] = lambda less, fitted, unseen=True, others=True: unseen,
    brief: bool = False,
    begun: Sequence[Step] = (),
    stop: Callable[[Fitted, Fitted], bool] = lambda fitted, best: False,
    patience: Patience | None = None,
) -> Ladder:
    """Forward selection from a fitted baseline, with detours at the end.

    Causes that are about as likely are refitted, and the most likely refit is taken; one that
    predicts what it was not fitted to worse than the model without it is refused.

    Parameters
    ----------
    held_out : rms errors of a rung on parts of the data that its refits did not see, and the
        factor by which each may rise
    noise_nm : of one recording, what no model falls below
    others : causes that were tried elsewhere (on the raw recordings), for the correction
    helps : whether the second fit predicts recordings better than the first, beyond doubt
    brief : only upwards: a model that explains most is all that is asked for
    begun : steps that some of the drives ask for, fitted to all of them
    stop : whether to go no further with what is fitted first, or with a rival of that: data or base
        are to be put right
    patience : how much was tried before; a climb that goes wrong ends where it is
    """
    search = Search(
        space, first, rng, tell, held_out, noise_nm, others, helps, stop=stop,
        patience=patience or Patience(),
    )
    search.patience.begin()
    with_own_bend(search)
    search.steps += begun
    search.rearranged = bool(begun)
    try:
        return _climbed(search, brief, bool(begun))
    except InputError as error:  # a law that holds no more where some fit has led
        return Ladder(search.first, tuple(search.steps), tuple(search.scans), error.what)


def _climbed(search: Search, brief: bool, begun: bool) -> Ladder:
    members = search.causes
    search.forward()
    if brief or search.stopped:
        return Ladder(search.first, tuple(search.steps), tuple(search.scans))
    clear(search)
    if not begun or set(search.causes) != set(members):
        around(search)
        if both(search):
            search.forward()
    search.steps = search.rungs()
    less_what_is_faint(search)
    for _ in range(ROUNDS):
        if not idle(search):
            break
        search.forward()
        faint(search)
    else:
        idle(search)
    note_the_other(search)
    return Ladder(search.first, tuple(search.rungs()), tuple(search.scans))


@dataclass(eq=False)
class Search:
    space: Space
    first: Fitted
    rng: np.random.Generator
    tell: Tell
    held_out: Sequence[tuple[Callable[[Fitted], float], float]]
    noise_nm: float
    others: int
    helps: Callable[..., bool]
    steps: list[Step] = field(default_factory=list)
    scans: list[Scan] = field(default_factory=list)
    barred: dict[str, str] = field(default_factory=dict)
    refused_at: dict[str, float] = field(default_factory=dict)  # held-out error to try again at
    looked_at: dict[str, float] = field(default_factory=dict)  # the same, for all forms of a law
    rearranged: bool = False
    aside: bool = False  # whether it climbs around a member
    most: int = MOST  # members
    goal: float = -np.inf  # evidence, below which the climb is for nothing
    level: float = 1.0  # chance of a false alarm that is asked for, beside the usual ones
    # refused for their held-out error, or because alone they say nothing
    spoiled: dict[str, Step] = field(default_factory=dict)
    safe: set[str] = field(default_factory=set)  # tables that nothing can stand in for
    errors: dict[tuple[int, int], tuple[float, Point]] = field(default_factory=dict)
    stop: Callable[[Fitted, Fitted], bool] = lambda fitted, best: False
    stopped: bool = False
    rather: list[int] = field(default_factory=list)  # what says more than a bend in this scan
    steep: list[int] = field(default_factory=list)  # what was begun at its size in this scan
    rivals: list[Fitted] = field(default_factory=list)  # refits that the newest member was one of
    patience: Patience = field(default_factory=Patience)

    @property
    def fitted(self) -> Fitted:
        return self.steps[-1].fitted if self.steps else self.first

    @property
    def causes(self) -> list[str]:
        return [s.cause for s in self.steps if s.cause != BEND]

    @property
    def few(self) -> bool:
        """Whether what stands in for what is quickly tried out."""
        return len(self.causes) <= FEW

    def left_over(self, fitted: Fitted | None = None) -> float:
        """Log-likelihood of what is left that nobody has a name for, of a model or the latest;
        0 where that may be chance.
        """
        ratio, chance = self.rest(self.fitted if fitted is None else fitted)
        return ratio if chance < LEVEL else 0.0

    def rest(self, fitted: Fitted) -> tuple[float, float]:
        """Log-likelihood of what a model leaves, and the chance that nothing is left."""
        settle(self.space, fitted.point)
        reduced = reduce(self.space.linear(fitted.point), every=True)
        return score_generic(Likelihood(reduced), self.rng, LEVEL)

    def forward(self) -> None:
        """Take in what the data ask for, one after the other."""
        before = -np.inf
        while len(self.causes) < self.most:
            here = self.fitted
            if self.patience.at_an_end or (self.aside and self.patience.lost):
                return
            hoped = HOPE * (self.most - len(self.causes)) * (here.evidence - before)
            if here.evidence + hoped < self.goal:
                return
            before = here.evidence
            self.tell(f"scan {len(self.scans) + 1}")
            settle(self.space, here.point)
            found = scan(self.space, here, self.rng, self.barred)
            self.rather, self.steep = [], []
            result = found.result
            self.scans.append(result)
            self.without_others_names(result)
            family = self.family(result)
            level = min(LATER if self.causes else LEVEL, self.level)
            good = np.flatnonzero(family < level)
            best = float(result.ratio[good].max()) if good.size else 0.0
            likeliest = int(good[np.argmax(result.ratio[good])]) if good.size else None
            plainly = PLAINLY
            if likeliest is not None and CAUSES[result.ids[likeliest]].has_elements:
                plainly = OF_A_TABLE  # which does whatever the law lacks, and much besides
            if bend(self, here, found, good):
                # bends are projected off before causes are scored: a small one changes no score
                small = self.fitted.evidence < here.evidence + LARGE
                if good.size or not small or self.left_over():
                    continue
                return
            if here.evidence + HOPE * min(self.most - len(self.causes), PAIR) * best < self.goal:
                return
            if likeliest is not None and self.let_go(here, plainly * best, found, likeliest):
                continue
            if good.size and self.take(here, found, good, family):
                first = [self.fitted, *self.rivals] if len(self.causes) == 1 else []
                self.stopped = any(self.stop(fitted, self.fitted) for fitted in first)
                if self.stopped:
                    return
                continue
            if self.patience.lost:
                return
            _, chance = self.rest(here)
            if chance >= LEVEL:
                if also(self, here, 0.0):  # a number more, which the dictionary does not hold
                    continue
                return
            if not (self.let_go(here, 0.0) or together(self, here)
                    or explained(self, here, found, family, chance)):  # fmt: skip
                return

    def without_others_names(self, result: Scan) -> None:
        """Rivals of the newest member which are asked for beside it much as before are names of
        another effect, that happened to be worth as much; but for what does nearly the same.
        """
        if not self.steps:
            return
        asked = dict(zip(result.ids, result.ratio, strict=True))
        newest = self.steps[-1]
        rivals = {
            id: gained for id, gained in newest.rivals.items()
            if asked.get(id, 0.0) < OF_ANOTHERS * gained
            or are_twins(self.space.groups, newest.cause, id)
        }  # fmt: skip
        self.steps[-1] = replace(newest, rivals=rivals)

    def let_go(self, here: Fitted, best: float, found: Found | None = None, i: int = 0) -> bool:
        """Let a member do more than it was taken in for, where that gains more than ``best``.

        ``i`` : number of the likeliest cause in what was found; a table must be worth less as well
        """
        def of_a_table() -> float:
            if found is None or not CAUSES[found.result.ids[i]].has_elements:
                return 0.0
            return max((worth for worth, *_ in tried(self, here, found, [i])), default=0.0)

        return also(self, here, best, of_a_table) or loosen(self, here, best)

    def family(self, result: Scan) -> FloatArray:
        tried = len(result.ids)
        return np.minimum(result.p_family * (tried + self.others) / max(tried, 1), 1.0)

    def take(
        self, here: Fitted, found: Found, good: NDArray[np.int64], family: FloatArray
    ) -> bool:
        """Refit with the likeliest causes and keep the best; False where none can be kept."""
        result = found.result
        family = result.of_their_kind(good, family)
        refits, any_close = raced(self, here, found, good)
        # that something is there is what was found; which of them it is the refits say
        family[self.steep] = np.minimum(family[self.steep], family[good].min())

        def likely(one: Tried) -> float:
            id = result.ids[one[1]]
            stage = one[2].point.model.stage(id)
            worth = one[0] - getattr(stage, "beyond", 0.0)
            worth *= 1.0 if getattr(stage, "plain", True) else FAR_LIKELIER
            return worth * (1.0 if of_base(id) or CAUSES[id].has_elements else OF_A_BEND)

        for worth, i, _ in refits:
            if worth <= 0.0 and of_base(result.ids[i]):  # slow to refit, and what is rarely needed
                self.bar(result.ids[i], here, SAYS_NO_MORE, MUCH_NEARER)
        for worth, i, fitted in sorted(carrying(self, refits), key=likely, reverse=True):
            id = result.ids[i]
            if worth <= 0.0:
                self.bar(id, here, SAYS_NO_MORE, MUCH_NEARER)
                self.spoiled[id] = Step(id, float(family[i]), fitted)  # alone, that is
                continue
            if gained(fitted, here) > LARGE:
                fitted = converged(self.space, fitted)
            chance = family[i] > DOUBTFUL and not of_base(id)
            doubtful = chance or self.may_go_on(id)
            against = worse(self, fitted, here, doubtful) or of_a_law(self, fitted, id, here)
            against = against or of_a_corner(self, fitted, here, id)
            # what is certainly there need only predict these recordings better
            if against is None and doubtful and not self.helps(here, fitted, others=chance):
                against = "fits, but does not predict data that it has not seen better beyond doubt"
            if against is None and self.harms(here, fitted):
                against = FITS + "worse beyond doubt"
            if against is not None:
                if against != OF_WARMTH:  # what is no cause does not spoil one
                    self.spoiled[id] = Step(id, float(family[i]), fitted)
                self.bar(id, here, against, NEARER)
                continue
            fitted = in_a_better_form(self, here, result, i, fitted)
            if self.masked(here, worth) or rather(self, here, fitted, id):
                return True
            self.rivals = [f for w, _, f in refits if f is not fitted and w > FAR_BEHIND * worth]
            rivals = {
                result.ids[j]: float(result.ratio[j]) for w, j, f in refits
                if j != i and not of_base(result.ids[j])
                and (w > worth - NEEDED or self.as_good(f, fitted, result.ids[j], worth - w))
            }
            others = {result.ids[j]: f for _, j, f in refits}
            asked = dict(zip(result.ids, result.ratio.tolist(), strict=True))
            for twin in foretelling_as_well(self, here, fitted, id, others, AS_WELL):
                rivals[twin] = asked.get(twin, 0.0)
            doubted = has_reach(id) and any(
                has_reach(result.ids[j]) for w, j, _ in refits if j != i and w > NEARLY * worth
            )
            self.accept(Step(id, float(family[i]), fitted, rivals, doubted))
            self.tidy()
            return True
        return foretold(self, here, found, refits, family) or any_close

    def as_good(
        self, rival: Fitted, fitted: Fitted, id: str, short: float | None = None
    ) -> bool:
        """Whether a rival says hardly less than a model, and predicts what is held out no worse.

        Causes whose difference has a d' below `confusion.APART` are not told apart; on the average
        their likelihoods differ by half the square of that.

        ``short`` : by how much less it says, if not by its evidence
        """
        short = fitted.evidence - rival.evidence if short is None else short
        if CAUSES[id].has_elements or short > 0.5 * APART**2:
            return False
        return self.error(0, rival) <= AS_WELL * self.error(0, fitted)

    def may_go_on(self, id: str) -> bool:
        """Whether what a member brings along from before a recording may be all there is of it."""
        members = [CAUSES[c] for c in self.causes]
        return any(
            issubclass(k, Cause) and id in k.brings_along for k in members
        ) and not all(g.virgin for g in self.space.groups.groups)

    def harms(self, here: Fitted, fitted: Fitted) -> bool:
        """Whether a model predicts recordings worse than one without its newest member."""
        return self.error(0, fitted) > self.error(0, here) and self.helps(fitted, here, False)

    def masked(self, here: Fitted, worth: float) -> bool:
        """Take in two that hide each other, where one alone is worth far more than what is next.

        A creep and a drift that nearly cancel: either alone predicts worse than neither.
        """
        most = max((s.fitted.evidence for s in self.spoiled.values()), default=-np.inf)
        if worth > MASKED * (most - here.evidence):
            return False
        spoiled = dict(self.spoiled)
        if together(self, here):
            return True
        self.spoiled = spoiled
        return False

    def tidy(self) -> None:
        """Drop what the newest member has made needless; look at the others once more."""
        members = len(self.causes)
        prune(self)
        self.scan_anew(members)
        if len(self.causes) > 1:
            rather_the_other(self)

    def scan_anew(self, members: int = 0) -> None:
        """Numbers with several summits, and forms, of members that were fitted while the newest was
        missing, or beside one of so many that has gone since.

        How far the laws of the first spring reach is looked for at the end, unless the newest is a
        table, and much is still amiss: a reach that was found without that one made up for it.
        One that says far more than the newest needed not make up for that.
        """
        said = self.said_when_taken()
        newest = 0.0 if len(self.causes) < members else said[self.causes[-1]]
        for id in self.causes if len(self.causes) < members else self.causes[:-1]:
            stage = self.fitted.point.model.stage(id)
            if not isinstance(stage, Cause) or 0.0 < newest < FAR_LESS * said[id]:
                continue
            scanned = stage.scanned[0] in stage.optional and stage.scanned[0] in stage.parameters
            beside_table = CAUSES[self.causes[-1]].has_elements and id != self.causes[-1]
            if scanned and "taper" in stage.parameters and beside_table and far_off(self):
                self.reach_anew(id)
            if scanned and "taper" not in stage.parameters:
                self.tell(f"refit with {id} anew")
                fitted = summit(self.space, self.fitted, id)
                if fitted.evidence > self.fitted.evidence + NEEDED:
                    self.steps[-1] = replace(self.steps[-1], fitted=fitted)
            fitted = in_another_form(self.space, self.fitted, id)
            fitted = in_another_shape(self.space, fitted, id)
            self.steps[-1] = replace(self.steps[-1], fitted=fitted)

    def said_when_taken(self) -> dict[str, float]:
        """Log-likelihood that every member said when it was taken in."""
        fits = [self.first, *(s.fitted for s in self.steps)]
        return {s.cause: s.fitted.evidence - before.evidence
                for s, before in zip(self.steps, fits, strict=False)}  # fmt: skip

    def reach_anew(self, id: str) -> None:
        """A law of the first spring once more in all its forms, wherever each may begin."""
        self.tell(f"refit with {id} anew, wherever it reaches")
        less = refit(self.space, self.fitted.point.without(id), held=True)
        there = reached(self.space, self.fitted, id, less)
        there = with_force_kept(self.space, there, id, less)
        if there.evidence > self.fitted.evidence + NEEDED and (
            self.error(0, there) <= self.error(0, self.fitted)
        ):
            self.steps[-1] = replace(self.steps[-1], fitted=there)

    def bar(self, id: str, here: Fitted, why: str, nearer: float) -> None:
        """Refuse a cause until so much of what is left beside the noise is left."""
        beyond = np.sqrt(max(self.error(0, here) ** 2 - self.noise_nm**2, 0.0))
        self.barred[id] = why
        self.refused_at[id] = float(np.hypot(self.noise_nm, nearer * beyond))

    def came_to_nothing(self, id: str, here: Fitted) -> None:
        """Refuse a cause whose refit is no different from nothing, or at a limit."""
        self.bar(id, here, CAME_TO_NOTHING, MUCH_NEARER)

    def accept(self, step: Step) -> None:
        """Add a rung; what was refused because the model was far off may be tried again."""
        self.steps.append(step)
        if step.fitted.point.model.stage(BEND) is None and any(s.cause == BEND for s in self.steps):
            # another kind has taken its place
            self.steps = [s for s in self.steps if s.cause != BEND]
            self.rearranged = True
        self.spoiled = {}
        left = self.error(0, step.fitted)
        self.barred = {
            k: why for k, why in self.barred.items()
            if why != OF_THE_MISFIT and left > self.refused_at.get(k, 0.0)
        }  # fmt: skip

    def keep_error(self, fitted: Fitted, error: float) -> None:
        """Held-out error of a rung by the first way of holding out, found elsewhere."""
        self.errors[0, id(fitted.point)] = error, fitted.point

    def error(self, k: int, fitted: Fitted) -> float:
        """Held-out error of a rung by the k-th way of holding out."""
        key = (k, id(fitted.point))
        if key not in self.errors:
            self.errors[key] = (self.held_out[k][0](fitted), fitted.point)
        return self.errors[key][0]

    def drop(self, id: str, new: Step, less: Fitted) -> None:
        """Take a member out for good; ``less`` is the model without it."""
        self.barred[id] = f"{BESIDE}{new.cause}"
        self.steps = [s for s in self.steps if s.cause != id]
        self.steps[-1] = replace(self.steps[-1], fitted=less)
        self.rearranged = True

    def rungs(self) -> list[Step]:
        """The steps, each fitted with those before it; made anew where members have changed."""
        if not self.rearranged or not self.steps:
            return self.steps
        return one_by_one(self.space, self.steps, self.tell)
