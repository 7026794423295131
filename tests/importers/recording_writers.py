"""Writers of recordings for the tests, one per format, by hand from the formats' descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

RATE = 1000.0


def triangle(samples: int = 400, rate: float = RATE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, command (-10..-2 V) and a sensor voltage that falls as the stack extends."""
    time = np.arange(samples) / rate
    phase = (time * 5.0) % 1.0
    command = -10 + 8 * (1 - np.abs(1 - 2 * phase))
    sensor = 1.25 - 0.05 * (command + 10) - 0.002 * (command + 10) ** 2
    return time, np.round(command, 6), np.round(sensor, 6)


def lvm_text(
    columns: Sequence[Sequence[float]],
    *,
    x_columns: str = "One",
    separator: str = "\t",
    decimal: str = ".",
    declare_decimal: bool = True,
    names: Sequence[str] = ("Command", "Sensor", "Monitor"),
    date: str = "2011/03/04",
    clock: str = "10:20:30.25",
    x0: str = "0.000000",
    delta_x: str = "0.001000",
    samples: int | None = None,
    comment: bool = True,
    special: bool = False,
    file_header: bool = True,
    end: str = "\r\n",
) -> str:
    """One segment (with its file header) of a LabVIEW measurement file.

    ``columns`` are times and channels for ``One``; channels alone for ``No``; time,
    channel, time, channel ... for ``Multi``.
    """
    word = {"\t": "Tab", ",": "Comma", ";": "Semicolon"}[separator]
    channels = {"One": len(columns) - 1, "No": len(columns), "Multi": len(columns) // 2}[x_columns]

    def local(text: str) -> str:
        return text.replace(".", decimal) if decimal == "," else text

    def per_channel(value: str) -> str:
        gap = separator * (2 if x_columns == "Multi" else 1)
        return separator + gap.join([local(value)] * channels) + separator

    lines = []
    if file_header:
        lines += [f"LabVIEW Measurement{separator}", f"Writer_Version{separator}2"]
        lines += [f"Reader_Version{separator}2", f"Separator{separator}{word}"]
        if declare_decimal:
            lines += [f"Decimal_Separator{separator}{decimal}"]
        lines += [f"Multi_Headings{separator}Yes", f"X_Columns{separator}{x_columns}"]
        lines += [f"Time_Pref{separator}Relative", f"Operator{separator}A. Müller"]
        lines += [f"Date{separator}{date}", f"Time{separator}{clock}"]
        if special:
            lines += ["***Start_Special***", f"X_Columns{separator}Multi", "***End_Special***"]
        lines += [f"***End_of_Header***{separator}", separator]
    lines += [f"Channels{separator}{channels}{separator}"]
    lines += ["Samples" + per_channel(str(len(columns[0]) if samples is None else samples))]
    lines += ["Date" + per_channel(date), "Time" + per_channel(clock)]
    lines += ["X_Dimension" + per_channel("Time"), "X0" + per_channel(x0)]
    lines += ["Delta_X" + per_channel(delta_x), f"***End_of_Header***{separator}"]
    chosen = list(names[:channels])
    if x_columns == "Multi":
        title = [part for name in chosen for part in ("X_Value", name)]
    else:
        title = ["X_Value", *chosen]
    lines += [separator.join([*title, "Comment"] if comment else title)]
    lead = [""] if x_columns == "No" else []
    for row in zip(*columns, strict=True):
        lines += [separator.join(lead + [local(f"{value:.6f}") for value in row])]
    return end.join(lines) + end


def write(path: Path, text: str, encoding: str = "cp1252") -> Path:
    """A file with exactly this text."""
    path.write_bytes(text.encode(encoding))
    return path


def csv_text(
    names: str, columns: Sequence[Sequence[float]], separator: str = ",", decimal: str = "."
) -> str:
    """A table with a header of comma-separated names."""
    rows = [separator.join(names.split(","))]
    for row in zip(*columns, strict=True):
        rows.append(separator.join(f"{value:.6f}".replace(".", decimal) for value in row))
    return "\n".join(rows) + "\n"


def write_tdms(
    path: Path,
    channels: dict[str, np.ndarray],
    group: str = "Rig",
    mode: str = "w",
    **properties: object,
) -> Path:
    """A TDMS file with one group; properties stand on every channel."""
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path), mode=mode) as writer:
        writer.write_segment(
            [ChannelObject(group, name, data, properties) for name, data in channels.items()]
        )
    return path
