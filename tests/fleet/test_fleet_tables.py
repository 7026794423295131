"""Names, outliers, table, page and journal of many inputs."""

from __future__ import annotations

import hashlib

import numpy as np
import pyarrow.parquet as pq
import pytest

from piezo_rig.fleet import items_of
from piezo_rig.fleet.journal import Journal, key_of
from piezo_rig.fleet.outliers import outliers, rare_findings, robust_z
from piezo_rig.fleet.page import Overview, page
from piezo_rig.fleet.table import write_table


def touched(tmp_path, *names):
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    return [str(tmp_path / name) for name in names]


@pytest.mark.parametrize("names", [
    ("a/x.h5", "b/x.h5", "b/X.csv"), ("x.h5", "x_extended.h5"), ("a_x.h5", "a/x.h5", "x.h5"),
    ("ä b.csv", "ä_b.csv"), ("...csv", "..h5"),
])  # fmt: skip
def test_no_two_inputs_share_an_output(tmp_path, names):
    endings = (".json", "_extended.json")
    items = items_of(touched(tmp_path, *names), endings)
    outputs = [f"{i.name}{e}".casefold() for i in items for e in endings]
    assert len(set(outputs)) == len(outputs) == 2 * len(names)
    assert not any(set(o) & set("/\\ ") for o in outputs)


def test_a_file_that_nobody_shares_a_name_with_keeps_its_own(tmp_path):
    items = items_of(touched(tmp_path, "a/one.h5", "two.csv"), (".json",))
    assert [i.name for i in items] == ["one", "two"]


def test_what_is_given_twice_is_done_once_and_the_order_stays(tmp_path):
    a, b = touched(tmp_path, "a.h5", "b.h5")
    assert [i.given for i in items_of([b, a, f"{tmp_path}/./b.h5"], (".json",))] == [b, a]


def test_a_folder_is_one_item_with_the_runs_and_recordings_in_it(tmp_path):
    touched(tmp_path, "A1/2.csv", "A1/1.h5", "A1/3.part.h5", "A1/1_classical.json", "A1/1.png")
    (item,) = items_of([str(tmp_path / "A1")], (".json",))
    assert item.name == "A1"
    assert item.files == (str(tmp_path / "A1/1.h5"), str(tmp_path / "A1/2.csv"))


def test_robust_z_is_that_of_its_definition():
    z = robust_z(np.arange(1.0, 10.0))  # median 5, distances 4 3 2 1 0 1 2 3 4: MAD 2
    np.testing.assert_allclose(z, 0.6745 * (np.arange(1.0, 10.0) - 5.0) / 2.0)
    same = robust_z(np.array([5.0] * 9 + [6.0]))  # MAD 0; mean absolute deviation 0.1
    np.testing.assert_allclose(same, [0.0] * 9 + [1.0 / 0.1253314])
    assert not robust_z(np.full(9, 3.0)).any()


def rows(count=20, origin="REAL"):
    values = np.linspace(0.9, 1.1, count)
    return [{"file": f"{origin}{i}.h5", "status": "done", "origin": origin, "actuator": f"S{i}",
             "rms_nm": float(v), "findings": []} for i, v in enumerate(values)]  # fmt: skip


def test_an_outlier_is_named_with_what_is_unusual_in_it():
    table = rows()
    table[3]["rms_nm"] = 5.0
    (found,) = outliers(table, ["rms_nm"])
    assert (found.file, found.actuator, found.column) == ("REAL3.h5", "S3", "rms_nm")
    assert found.value == 5.0
    assert found.z > 3.5


def test_origins_are_compared_among_themselves_and_a_few_are_not_compared_at_all():
    simulated = [{**r, "rms_nm": r["rms_nm"] + 50.0} for r in rows(20, "SIMULATED")]
    assert not outliers([*rows(), *simulated], ["rms_nm"])
    few = rows(7)
    few[0]["rms_nm"] = 1e6
    assert not outliers(few, ["rms_nm"])


def test_a_cause_that_hardly_any_other_has_is_named_with_its_files():
    table = rows(100)
    for row in table[:60]:
        row["findings"] = ["creep"]
    table[7]["findings"] = ["creep", "mains-hum"]
    assert rare_findings(table) == [("mains-hum", ["REAL7.h5"])]
    assert not rare_findings(table[:40])


def test_the_table_holds_a_row_for_each_with_types_and_units(tmp_path):
    done = {**rows(1)[0], "sweeps": 6, "creep.rate": 0.02, "findings": ["creep"],
            "unexplained": False}
    bad = {"file": "bad.h5", "status": "failed", "error_code": "run-file", "error_text": "broken"}
    path = write_table([done, bad], tmp_path / "t.parquet", {"creep.rate": "1"})
    table = pq.read_table(path)
    assert table.num_rows == 2
    assert table.schema.field("creep.rate").metadata == {b"unit": b"1"}
    assert table["sweeps"].to_pylist() == [6, None]
    assert table["findings"].to_pylist() == [["creep"], None]
    assert table["error_code"].to_pylist() == [None, "run-file"]
    empty = write_table([bad], tmp_path / "none.parquet")
    assert pq.read_table(empty)["status"].to_pylist() == ["failed"]


def test_the_page_needs_nothing_else_and_takes_names_for_text():
    table = rows()
    table[3] |= {"rms_nm": 5.0, "file": "<script>alert(1)</script>.h5"}
    table.append({"file": "bad&.h5", "status": "failed", "error_code": "run-file",
                  "error_text": "cannot <b> be read"})
    text = page(Overview("identified", table, {"model": "<i>"}))
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;.h5" in text
    assert "bad&amp;.h5" in text
    assert "cannot &lt;b&gt; be read" in text
    assert "&lt;i&gt;" in text
    assert "20 of 21 inputs were identified; 1 failed." in text
    assert "One of them stands out" in text
    assert "prefers-color-scheme: dark" in text
    assert "://" not in text.replace("http://www.w3.org", "")
    assert text == page(Overview("identified", table, {"model": "<i>"}))


@pytest.mark.parametrize("table", [
    [], rows(3), [{"file": "x", "status": "failed", "error_code": "e", "error_text": "t"}],
    [{**r, "rms_nm": 2.0} for r in rows()], [{**r, "rms_nm": float("nan")} for r in rows()],
])  # fmt: skip
def test_a_page_of_few_or_equal_or_no_numbers_is_a_page(table):
    assert "</html>" in page(Overview("diagnosed", table))


def test_the_page_counts_findings():
    table = rows(20)
    for row in table[:5]:
        row |= {"findings": ["creep"], "creep.gain_percent": 40.0, "unexplained": True}
    text = page(Overview("diagnosed", table))
    assert "5 of 20" in text
    assert "No cause was named in 15; something stays unexplained in 5." in text


def test_the_journal_knows_what_stands_as_it_was_written(tmp_path):
    out, key = tmp_path / "a.json", key_of({"model": "range"})
    out.write_bytes(b"model")
    Journal(tmp_path, key).add({"name": "a", "sha256": "1", "row": {}, "said": []},
                               {out: b"model"})  # fmt: skip
    with (tmp_path / "journal.jsonl").open("a") as handle:
        handle.write('{"name": "b", "torn')
    journal = Journal(tmp_path, key)
    assert journal.known("a")["sha256"] == "1"
    assert journal.known("a")["outputs"] == {str(out): hashlib.sha256(b"model").hexdigest()}
    assert journal.known("b") is None
    assert Journal(tmp_path, key_of({"model": "classical"})).known("a") is None
    journal.add({"name": "c", "sha256": "2", "row": {}, "said": []}, {})
    assert Journal(tmp_path, key).known("c")["sha256"] == "2"
    out.write_bytes(b"another")
    assert journal.known("a") is None
