"""The tutorial's commands do what it says, in its order."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

from piezo_rig.cli import VERBS, main

CHECKOUT = Path(__file__).resolve().parents[2]
PAGE = (CHECKOUT / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def words_of(line: str) -> list[str]:
    """A line as a shell would split it, with patterns of file names filled in."""
    words = []
    for word in shlex.split(line, comments=True):
        found = sorted(str(p) for p in Path().glob(word)) if "*" in word else []
        words += found or [word]
    return words


def with_tables(config: str, tables: str) -> str:
    """A config in which whole tables are replaced by others of their names."""
    for table in re.split(r"^(?=\[)", tables, flags=re.MULTILINE)[1:]:
        name = re.escape(table.partition("\n")[0])
        config, replaced = re.subn(rf"(?ms)^{name}\n.*?(?=^\[)", lambda m, t=table: t, config)
        assert replaced == 1, name
    return config


def follow() -> list[str]:
    """Do all that the page says in the current folder; returns the verbs that were called.

    Blocks go into their files as they are printed.
    """
    called = []
    for kind, text in BLOCK.findall(PAGE):
        if kind in ("toml", "csv"):
            head = text.splitlines()[0].removeprefix("# ")
            how, name = re.fullmatch(r"(at the end of |in |)(\S+)", head).groups()
            before = Path(name).read_text(encoding="utf-8") if how else ""
            after = with_tables(before, text) if how == "in " else before + text
            Path(name).write_text(after, encoding="utf-8")
        elif kind == "sh":
            for line in text.splitlines():
                program, *words = words_of(line)
                if program == "cp":
                    shutil.copy(*words)
                    continue
                assert program == "piezo-rig", line
                expected = re.search(r"# .*exit status (\d)", line)
                assert main(words) == (int(expected[1]) if expected else 0), line
                called.append(words[0])
    return called


def test_every_command_of_the_tutorial_does_what_the_page_says(tmp_path, monkeypatch, capsys):
    (tmp_path / "configs").symlink_to(CHECKOUT / "configs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("piezo_rig.commands.watch.WAIT_S", 1.0)  # no other terminal begins a run
    called = follow()
    assert called == [
        "doctor", "calibrate", "doctor", "plan", "run", "watch", "show", "verify", "export",
        "identify", "simulate", "compensate", "export", "diagnose",
    ]  # fmt: skip
    said = capsys.readouterr()
    assert said.err == ""
    assert re.findall(r"FAULT .*", said.out) == re.findall(r"FAULT .* noise at rest .*", said.out)
    assert said.out.count("\n1 fault\n") == called.count("doctor") == 2
    assert len(re.findall(r"\n  ok +piezo +at rest, 0\.0\d V .*\n1 fault\n", said.out)) == 2
    (ladder,) = (text for kind, text in BLOCK.findall(PAGE) if kind == "text")
    rungs = re.findall(r"^  \+ (\S+)", ladder, re.MULTILINE)
    assert re.findall(r"^  \+ (\S+)", said.out, re.MULTILINE) == rungs
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    hum, skew = found["findings"]
    assert hum["cause"] == "mains-hum"
    assert abs(hum["parameters"]["amplitude"]["value"] - 25.0) < 2.0  # as in bench.toml
    assert skew["cause"] == "time-skew"
    assert 0.5e-3 < skew["parameters"]["delay"]["value"] < 1.5e-3  # a sample
    for name in ("diagnosis.html", "ladder.png", "extended.json", "predicted.csv", "model.json",
                 "model.c"):
        assert (tmp_path / name).stat().st_size > 1000


def test_the_tutorial_names_no_verb_that_is_not_there():
    named = set(re.findall(r"piezo-rig (?:run --resume|([a-z]+))", PAGE)) - {""}
    assert named <= {*VERBS, "is"}
