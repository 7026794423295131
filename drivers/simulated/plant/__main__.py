"""Prints every setting of the plant as a Markdown table: ``python -m drivers.simulated.plant``."""

from drivers.simulated.plant import settings


def table() -> str:
    """Rows of key, default, unit, meaning, in the order of the signal chain."""
    rows = ["| key | default | unit | meaning |", "|---|---|---|---|"]
    for key, default, unit, meaning in settings():
        shown = str(default).lower() if isinstance(default, bool) else f"{default}"
        rows.append(f"| `{key}` | {shown} | {unit} | {meaning} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
