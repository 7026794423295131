"""docs/diagnosis.md from the rows of the hidden-effect study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from piezo_rig.scoring.counts import Row, matrix, summary

HEAD = """# How well the diagnosis does

Written by `make study-diagnosis`. Effects are hidden in recordings of a bench of its own
(`piezo_rig/studies/hidden`), which shares no code with the models that are fitted: random
Prandtl-Ishlinskii bodies whose thresholds lie on no grid, every second to third of them with a
memoryless curvature, in white, AR(0.95) and 1/f-like noise. `diagnose` gets the recordings and
nothing else, at most 50,000 samples a case, two repeats.

*d'* is the oracle's: the length of the effect in the space whitened by the true noise, after 50
play operators, drive powers and offsets have been projected off. At d' = 40 an oracle that knows
the true form misses nothing; what it would call wrong is what the confusion in the data makes it.
Of several effects at once it is what is left of each once the others are projected off, so that
the oracle would name all of them: "no more than hidden" counts the cases with as many findings or
fewer, "nor alternatives" those whose findings and alternatives together are no more. The oracle
cannot tell another cause from a hidden one either where less than d' = 4 is left of the hidden one
off an example of the other: "no more than the oracle's" counts the cases whose findings and
alternatives are no more than what is hidden and those. A stranger may be much like a known cause;
what is left of its d' off the nearest one says how much of a stranger it is.
Form A of an effect is the catalogue's own law, with parameters that can be compared; form B is
other physics under the same name (three relaxations for creep, rate-dependent thresholds, smooth
laws after a turning point, an exponential warm-up). "In set" counts the cause or its listed
alternatives. A gain counts against a second session of the same conditions with new noise. The
gain on an unseen drive is that of the saved model over the baseline, as a share of what is left
to somebody who knew the effect.

"""
BY_HAND = "## What it still gets wrong\n"


def write(rows: Sequence[Row], out: Path) -> None:
    """The document of rows of the study; what stands by hand at its end is kept."""
    _, heading, rest = (out.read_text(encoding="utf-8") if out.exists() else "").partition(BY_HAND)
    alone = [r for r in rows if len(r["truth"]["causes"]) < 2]
    text = HEAD + summary(rows) + "\n\n## First findings\n\n" + matrix(alone) + "\n"
    text += "\n" + heading + rest if heading else ""
    out.write_text(text, encoding="utf-8", newline="\n")
