"""What an import has to say about files, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path


class Sentences:
    """Sentences about files; what holds of several files is said once."""

    def __init__(self, names: Mapping[Path, str]) -> None:
        self._names = names
        self._files: dict[str, list[str]] = {}

    def name(self, path: Path) -> str:
        """What a file is called in sentences, and as the source of its sweeps."""
        return self._names[path]

    def add(self, file: str | Path, sentences: Sequence[str]) -> None:
        if isinstance(file, Path):
            file = self.name(file)
        for sentence in sentences:
            files = self._files.setdefault(sentence, [])
            if file not in files:
                files.append(file)

    def lines(self) -> list[str]:
        lines = []
        for sentence, files in self._files.items():
            if len(files) > 3:
                whose = f"{files[0]}, {files[1]} and {len(files) - 2} more"
            else:
                whose = ", ".join(files)
            lines.append(f"{whose}: {sentence}" if whose else sentence)
        return lines
