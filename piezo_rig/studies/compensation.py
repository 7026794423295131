"""Plays targets with and without compensation, model by model, and writes docs/compensation.md.

``make study-compensation``. Everything goes through the command line and the drivers of the
simulated bench; every number in the document comes from here, the prose from
``compensation_template.md``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import load_model
from piezo_rig.chain import Elements, Maxwell, Model, save_model
from piezo_rig.errors import InputError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.studies.compensation_targets import RATE, REST_S, targets
from piezo_rig.studies.document import fill, number, table

FloatArray = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
REPEATS = 3
ALLOWED = 1.5
DATA, FEWER = "before_compensation", "quick_look"  # protocols
STRAIGHT, EXTENDED, UNLED = "none", "extended", "extended, free end"
QUICK = f"extended, {FEWER}"
IDENTIFIED = ("classical", "initiation", "range", "extremum")
OUT_OF_REACH = 3
SHOWN = "minor loops"


@dataclass(frozen=True, eq=False)
class Tracked:
    """The errors of one target with one model, nm: shape (repeats, n), and their own means."""

    errors_nm: FloatArray
    means_nm: FloatArray
    travel_um: float

    @property
    def rms_nm(self) -> float:
        return float(np.sqrt(np.mean(self.errors_nm**2)))

    @property
    def max_nm(self) -> float:
        return float(np.abs(self.errors_nm).max())

    @property
    def floor_nm(self) -> float:
        """What these repeats disagree by."""
        return float(np.sqrt(np.mean(np.var(self.errors_nm, axis=0, ddof=1))))


Found = dict[tuple[str, str], Tracked]


def program(*words: object, allowed: tuple[int, ...] = (0,)) -> int:
    """Run one verb in a process of its own; returns its exit status."""
    line = [sys.executable, "-m", "piezo_rig", *map(str, words)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode not in allowed:
        raise InputError("study", f"{' '.join(line)}: {done.stderr.strip()}")
    return done.returncode


def run_in(folder: Path) -> Path:
    """The one run of a folder."""
    (path,) = folder.glob("*.h5")
    return path


def straight_line(sweeps: list[Sweep]) -> Model:
    """One spring, from the slope of a straight line through all that was played."""
    moved = [s.displacement_um - s.displacement_um[0] for s in sweeps]
    driven = [s.drive_v - s.drive_v[0] for s in sweeps]
    slope = sum(float(v @ x) for v, x in zip(driven, moved, strict=True))
    slope /= sum(float(v @ v) for v in driven)
    return Model((Maxwell.of(Elements(np.array([1.0 / slope]), np.array([1e3]))),), name="line")


def make_models(folder: Path) -> dict[str, Path]:
    """Play the data, and every model of them."""
    data = played(DATA, folder)
    found = {STRAIGHT: folder / "line.json"}
    save_model(straight_line(Run(data).sweeps()), found[STRAIGHT])
    for name in IDENTIFIED:
        found[name] = folder / f"{name}.json"
        program("identify", data, "--model", name, "--out", found[name])
    found[EXTENDED] = found[UNLED] = folder / "extended.json"
    program("diagnose", data, "--save-model", found[EXTENDED], "--json", folder / "diagnosis.json")
    found[QUICK] = folder / "quick.json"
    program("diagnose", played(FEWER, folder), "--save-model", found[QUICK])
    return found


def played(protocol: str, folder: Path) -> Path:
    """The run of a shipped protocol."""
    program("run", protocol, "--out", folder / protocol)
    return run_in(folder / protocol)


def track(models: dict[str, Path], folder: Path) -> Found:
    """Compensate, play and measure every target with every model."""
    wanted = targets()
    for name, um in wanted.items():
        table_ = np.column_stack([np.arange(um.size) / RATE, um])
        np.savetxt(folder / f"{name}.csv", table_, delimiter=",", fmt="%.12g", comments="",
                   header="time_s,displacement_um")  # fmt: skip
    found: Found = {}
    for label, model in models.items():
        text = [f'schema = "piezo-rig/protocol/1"\nname = "follow"\nrepeats = {REPEATS}\n']
        for name in wanted:
            out = f"{label} {name}.csv"
            words = ["--free-end"] if label == UNLED else []
            status = program("compensate", model, folder / f"{name}.csv", "--out", folder / out,
                             *words, allowed=(0, OUT_OF_REACH))  # fmt: skip
            if status == 0:
                text.append(f'[[condition]]\nname = "{name}"\nwaveform = "file"\npath = "{out}"\n')
        protocol = folder / f"{label}.toml"
        protocol.write_text("".join(text), encoding="utf-8")
        program("run", protocol, "--out", folder / f"{label} run")
        sweeps = Run(run_in(folder / f"{label} run")).sweeps()
        for name, um in wanted.items():
            played = [s for s in sweeps if s.condition == name]
            if played:
                found[label, name] = measured(played, um)
        print(f"{label}: " + ", ".join(
            f"{name} {found[label, name].rms_nm:.1f} nm" for name in wanted
            if (label, name) in found), flush=True)  # fmt: skip
    return found


def measured(sweeps: list[Sweep], target_um: FloatArray) -> Tracked:
    """The errors of the repeats of one target, from the first motion on."""
    begin = round(REST_S * RATE)
    rows = [1e3 * (s.displacement_um[: target_um.size] - target_um)[begin:] for s in sweeps]
    errors = np.array(rows)
    means = errors.mean(axis=1)
    return Tracked(errors - means[:, None], means, float(np.ptp(target_um[begin:])))


def document(
    found: Found, models: dict[str, Path], diagnosis: dict, slope: float, took_s: float
) -> str:
    """The page."""
    names = list(targets())
    extended = load_model(models[EXTENDED])
    skew = extended.stage("time-skew")
    floor = float(diagnosis["noise_floor_nm"])
    rows = []
    for name in names:
        for label in models:
            one = found.get((label, name))
            if label in (UNLED, QUICK):
                continue
            first = f"**{name}**" if label == STRAIGHT else ""
            if one is None:
                rows.append((first, label, "out of reach", "-", "-"))
                continue
            rows.append((first, label, number(one.rms_nm, 1), number(one.max_nm, 0),
                         number(0.1 * one.max_nm / one.travel_um, 2)))  # fmt: skip
    tracked = {name: found[EXTENDED, name] for name in names}
    worst = max(one.rms_nm for one in tracked.values()) / floor
    return fill((HERE / "compensation_template.md").read_text(encoding="utf-8"), {
        "targets": str(len(names)), "repeats": str(REPEATS), "slope": number(slope, 4),
        "errors": table(("target", "model", "rms, nm", "largest, nm", "largest, %"), rows),
        "floor": number(floor, 2),
        "stages": ", ".join(f"`{s.id}`" for s in extended.stages),
        "ratios": table(
            ("target", "rms, nm", "over the noise floor", "these repeats disagree by, nm"),
            ((name, number(one.rms_nm, 2), number(one.rms_nm / floor, 2), number(one.floor_nm, 2))
             for name, one in tracked.items()),
        ),
        "data": DATA, "fewer": FEWER,
        "quick": table(
            ("target", f"{DATA}, nm", f"{FEWER} alone, nm"),
            ((name, number(tracked[name].rms_nm, 2), number(found[QUICK, name].rms_nm, 2))
             for name in names),
        ),
        "quick_stages": ", ".join(f"`{s.id}`" for s in load_model(models[QUICK]).stages),
        "verdict": f"The largest is {number(worst, 2)} times the noise floor; "
        + (f"at most {ALLOWED} was asked for." if worst <= ALLOWED
           else f"**at most {ALLOWED} was asked for.**"),
        "delay": number(1e3 * skew["delay"], 3) if skew else "0",
        "lead": table(
            ("target", "rms with the lead, nm", "rms without, nm"),
            ((name, number(tracked[name].rms_nm, 2), number(found[UNLED, name].rms_nm, 2))
             for name in names),
        ),
        "sample_noise": number(floor, 1),
        "zeros": table(
            ("target", *(f"repeat {k + 1}" for k in range(REPEATS))),
            ((name, *(number(m, 1) for m in one.means_nm)) for name, one in tracked.items()),
        ),
        "minutes": number(took_s / 60.0, 0),
    })  # fmt: skip


def figure(found: Found, path: Path) -> None:
    """What is wanted of one target, and the errors that every model leaves, over time."""
    from piezo_rig.report.figures import ERROR, MEASURED, thin
    from piezo_rig.studies.thesis_figures import canvas, compact, finish

    labels = [label for label in (STRAIGHT, *IDENTIFIED, EXTENDED) if (label, SHOWN) in found]
    drawn, axes = canvas(len(labels) + 1, 1, (9.5, 1.5 * (len(labels) + 1)))
    begin = round(REST_S * RATE)
    um = targets()[SHOWN][begin:]
    time_s = np.arange(um.size) / RATE
    t, y = thin(time_s, um, most=1500)
    axes[0, 0].plot(t, y, color=MEASURED, linewidth=1.0)
    finish(axes[0, 0], "", "wanted (um)")
    for axis, label in zip(axes[1:, 0], labels, strict=True):
        one = found[label, SHOWN]
        t, y = thin(time_s, one.errors_nm[0], most=1500)
        axis.plot(t, y, color=ERROR, linewidth=0.7)
        finish(axis, "", "error (nm)", f"{label}: rms {one.rms_nm:.1f} nm")
    axes[-1, 0].set_xlabel("time (s)")
    compact(drawn, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument("--out", type=Path, default=Path("docs/compensation.md"))
    args = parser.parse_args()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="compensation-") as name:
        folder = Path(name)
        models = make_models(folder)
        diagnosis = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        found = track(models, folder)
        images = args.out.parent / "images"
        images.mkdir(parents=True, exist_ok=True)
        figure(found, images / "compensation.png")
        line = load_model(models[STRAIGHT]).branches()
        slope = float(line.initiation.compliance_um_per_v[0])
        took_s = time.monotonic() - begun
        args.out.write_text(document(found, models, diagnosis, slope, took_s), encoding="utf-8")
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
