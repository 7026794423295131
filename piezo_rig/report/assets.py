"""The page's style and script, kept as files of their own beside this one."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent


def style() -> str:
    return (HERE / "page.css").read_text(encoding="utf-8")


def script() -> str:
    return (HERE / "page.js").read_text(encoding="utf-8")
