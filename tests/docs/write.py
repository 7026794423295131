"""Writes the parts of the documents that the program knows best: ``make docs``."""

from pathlib import Path

from drivers.simulated import __main__ as faults
from drivers.simulated.plant import __main__ as plant
from piezo_rig.studies.causes import computed_of, page

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE, CAUSES = DOCS / "simulated-bench.md", DOCS / "causes.md"


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for table in (faults.table(), plant.table()):
        head = table.splitlines()[0]
        before, _, rest = text.partition(head)
        after = "".join(rest.partition("\n\n")[1:])
        text = f"{before}{table}{after}"
    PAGE.write_text(text.rstrip() + "\n", encoding="utf-8")
    computed = computed_of(CAUSES.read_text(encoding="utf-8"))
    CAUSES.write_text(page(computed), encoding="utf-8")


if __name__ == "__main__":
    main()
