"""The page on new drivers is run as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import drivers.kinds
import drivers.simulated.bench
import piezo_rig.config.rig
from piezo_rig.resources import shipped_folder

PAGE = Path(__file__).resolve().parents[2] / "docs" / "new-driver.md"
BLOCK = re.compile(r"^```(python|toml)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def test_the_worked_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for module in (drivers.kinds, drivers.simulated.bench):
        monkeypatch.setattr(module, "AMPLIFIERS", dict(module.AMPLIFIERS))
    monkeypatch.setattr(
        piezo_rig.config.rig, "AMPLIFIER_DRIVERS", piezo_rig.config.rig.AMPLIFIER_DRIVERS
    )
    text = PAGE.read_text()
    shipped = (shipped_folder("configs") / "simulated_bench.toml").read_text()
    room: dict[str, object] = {"__name__": "new_driver"}
    blocks = list(BLOCK.finditer(text))
    assert [b.group(1) for b in blocks] == ["python"] * 4 + ["toml", "python"]
    for block in blocks:
        kind, code = block.groups()
        if kind == "toml":
            own = re.sub(r"^\[amplifier\]\n.*?\n\n", code + "\n", shipped, flags=re.S | re.M)
            assert code in own
            (tmp_path / "my_bench.toml").write_text(own)
        else:
            line = text[: block.start()].count("\n") + 1
            exec(compile("\n" * line + code, str(PAGE), "exec"), room)


def test_a_config_knows_the_drivers_by_the_names_that_they_have():
    known = set(piezo_rig.config.rig.AMPLIFIER_DRIVERS)
    assert known == {*drivers.kinds.AMPLIFIERS, drivers.kinds.MANUAL}
    assert known == set(drivers.simulated.bench.AMPLIFIERS)
    assert drivers.kinds.CARD in piezo_rig.config.rig.DAC_DRIVERS
