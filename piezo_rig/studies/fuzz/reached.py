"""Which steps from line to line of this program an input took, by the interpreter's own trace."""

from __future__ import annotations

import sys
from types import FrameType, TracebackType
from typing import Any

_PACKAGE = "piezo_rig"


class Reached:
    """A context that notes steps inside the package; ``steps`` are hashes of (from, to)."""

    def __init__(self) -> None:
        self.steps: set[int] = set()
        self._files: dict[str, int] = {}

    def __enter__(self) -> Reached:
        self.steps = set()
        sys.settrace(self._call)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        number = self._files.get(name)
        if number is None:
            ours = _PACKAGE in name and "fuzz" not in name
            number = self._files[name] = len(self._files) + 1 if ours else 0
        if not number:
            return None
        base, last, steps = number << 20, 0, self.steps

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            nonlocal last
            if event == "line":
                steps.add(base + (last << 40) + frame.f_lineno)
                last = frame.f_lineno
            return line

        return line
