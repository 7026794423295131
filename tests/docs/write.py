"""Writes the parts of the documents that the program knows best: ``make docs``."""

from pathlib import Path

from drivers.simulated.plant.__main__ import table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "simulated-bench.md"


def main() -> None:
    prose = PAGE.read_text(encoding="utf-8").split("| key |")[0].rstrip()
    PAGE.write_text(f"{prose}\n\n{table()}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
