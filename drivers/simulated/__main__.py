"""Prints every fault as a Markdown table: ``python -m drivers.simulated``."""

from drivers.simulated.faults import KINDS


def table() -> str:
    """Rows of fault, value by default, how often it strikes, instruments, meaning."""
    rows = ["| fault | value | times | of | meaning |", "|---|---|---|---|---|"]
    for name, kind in KINDS.items():
        value = "" if kind.value is True else f"`{kind.value}`"
        times = str(kind.times) if kind.times else "always"
        of = "all" if len(kind.instruments) == 3 else ", ".join(kind.instruments)
        rows.append(f"| `{name}` | {value} | {times} | {of} | {kind.text} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
