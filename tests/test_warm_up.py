"""Set-up leaves nothing that every later command would have to do again."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest

from piezo_rig.warm_up import write_bytecode


def _loaded(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_bytecode_is_written_where_python_is_told_to_write_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    source = tmp_path / "quantity.py"
    source.write_text("VALUE = 7\n", encoding="utf-8")
    module = _loaded(source)
    kept = Path(importlib.util.cache_from_source(str(source)))
    assert not kept.exists()
    write_bytecode([module, sys])  # a module without a source is passed by
    written = kept.stat().st_mtime_ns
    write_bytecode([module])
    assert kept.stat().st_mtime_ns == written
    # what Python reads is the bytecode: it is of the source, by its time and length
    shown = source.stat()
    source.write_text("VALUE = 8\n", encoding="utf-8")
    os.utime(source, ns=(shown.st_atime_ns, shown.st_mtime_ns))
    assert _loaded(source).VALUE == 7
