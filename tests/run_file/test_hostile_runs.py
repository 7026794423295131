"""Run files that somebody made to hurt: one clear error, or faults by name; never more."""

from __future__ import annotations

import gzip
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezo_rig.cli import main
from piezo_rig.errors import PiezoRigError
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify import verify
from piezo_rig.studies.fuzz.hostile_h5 import HOSTILE, write_hostile, write_plain

# What a file may hold besides a whole sweep without doing any harm to it.
HARMLESS = {"deep groups"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("hostile")


@pytest.mark.parametrize("name", list(HOSTILE))
def test_a_hostile_run_is_faults_or_one_error(folder, capfd, name):
    path = write_hostile(name, folder / f"{name.replace(' ', '_')}.h5")
    status = main(["verify", str(path)])
    said = capfd.readouterr()
    if name in HARMLESS:
        assert status == 0
    elif status == 1:
        assert "FAULT" in said.out
    else:
        assert status == 2
        assert said.err.startswith("error[run-file]: ")
    assert "internal" not in said.err
    assert main(["show", str(path), "--log"]) in (0, 2)
    said = capfd.readouterr()
    assert "internal" not in said.err
    assert "\x1b" not in said.out + said.err  # nothing that a terminal obeys


def test_identify_of_a_hostile_run_is_one_error(folder, tmp_path, capfd):
    path = write_hostile("huge shapes, nothing written", folder / "huge.h5")
    assert main(["identify", str(path), "--model", "classical",
                 "--out", str(tmp_path / "m.json")]) == 2
    assert capfd.readouterr().err.startswith("error[no-data]: ")


BROKE = sorted((Path(__file__).parent / "broke").glob("*.h5.gz"))


@pytest.mark.parametrize("packed", BROKE, ids=lambda path: path.name.removesuffix(".h5.gz"))
def test_what_broke_in_a_campaign(packed, tmp_path, capfd):
    """Files on which HDF5 2.0 crashed or never came back."""
    path = tmp_path / "broke.h5"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    assert main(["verify", str(path)]) == 2
    assert capfd.readouterr().err.startswith("error[run-file]: ")


def test_a_file_is_tried_again_when_it_has_changed(tmp_path):
    path = tmp_path / "r.h5"
    write_plain(path)
    assert Run(path).sweep_names == ["sweep_0001"]
    path.write_bytes(gzip.decompress(BROKE[0].read_bytes()))
    with pytest.raises(PiezoRigError):
        verify(path)


MEASURE = """
import resource, sys
from pathlib import Path
from piezo_rig.studies.fuzz.campaign import judge
from piezo_rig.studies.fuzz.formats import FORMATS
for path in sorted(Path(sys.argv[1]).glob("*.h5")):
    if path.stat().st_size < 1_000_000:
        verdict, details = judge(FORMATS["h5"], path)
        print(verdict, path.name, details)
"""


def test_small_files_cost_little(folder):
    """Under 500 MB and 5 s each, in a process of its own that has read all of them."""
    for name in HOSTILE:
        path = folder / f"{name.replace(' ', '_')}.h5"
        if not path.exists():
            write_hostile(name, path)
    done = subprocess.run([sys.executable, "-c", MEASURE, str(folder)], capture_output=True,
                          text=True, check=True)
    bad = [line for line in done.stdout.splitlines() if line.split()[0] not in ("ok", "error")]
    assert len(done.stdout.splitlines()) > 30
    assert not bad


def test_nothing_outside_the_file_is_read(folder, tmp_path):
    """A row that stands in another file is refused, though HDF5 would read it."""
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(range(24)))
    path = write_plain(tmp_path / "r.h5")
    with h5py.File(path, "r+") as f:
        group = f["entry/sweep_0001"]
        del group["sensor_v"]
        group.create_dataset("sensor_v", shape=(24,), dtype="u1", external=[(str(secret), 0, 24)])
        group["sensor_v"].attrs["units"] = "V"
        assert list(group["sensor_v"][:3]) == [0, 1, 2]
    assert any("another file" in v.text for v in verify(path)[1])
    with pytest.raises(PiezoRigError):
        Run(path).sweeps()


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> bytes:
    return write_plain(tmp_path_factory.mktemp("plain") / "p.h5", 2).read_bytes()


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(edits=st.lists(st.tuples(st.integers(0, 60_000), st.binary(min_size=1, max_size=8)),
                      min_size=1, max_size=6), cut=st.none() | st.integers(0, 60_000))
def test_any_damage_to_headers_without_checksums(plain, tmp_path_factory, edits, cut):
    data = bytearray(plain)
    for at, new in edits:
        at %= len(data)
        data[at : at + len(new)] = new
    path = tmp_path_factory.getbasetemp() / "edited.h5"
    path.write_bytes(data[: cut if cut is None else cut % len(data)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            names, found = verify(path)
            bad = {v.sweep for v in found if v.fault}
            run = Run(path)
            for name in set(names) - bad:
                (sweep,) = run.sweeps([name])
                assert sweep.samples == 24
        except PiezoRigError as error:
            assert error.exit_status == 2
            assert error.what
