"""Writes the parts of the documents that the program knows best: ``make docs``."""

from pathlib import Path

from drivers.simulated.plant.__main__ import table
from piezo_rig.studies.causes import computed_of, page

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE, CAUSES = DOCS / "simulated-bench.md", DOCS / "causes.md"


def main() -> None:
    prose = PAGE.read_text(encoding="utf-8").split("| key |")[0].rstrip()
    PAGE.write_text(f"{prose}\n\n{table()}\n", encoding="utf-8")
    computed = computed_of(CAUSES.read_text(encoding="utf-8"))
    CAUSES.write_text(page(computed), encoding="utf-8")


if __name__ == "__main__":
    main()
