"""One sweep as TDMS, as LabVIEW reads it: a group of waveforms with their settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from piezo_rig.run_file.exporters.export import Piece


def write_tdms(path: Path, piece: Piece) -> None:
    """Volts as waveforms; group and channels carry the settings.

    ``wf_start_time`` is the wall clock's, for other programs; ``start_time`` the run's own.
    Samples that are not evenly spaced have a channel ``time_s``.
    """
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    sweep = piece.sweep
    settings: dict[str, Any] = dict(piece.settings)
    group = "sweep"
    waveform: dict[str, Any] = {
        "unit_string": "V",
        "wf_start_time": np.datetime64(round(piece.wall_s * 1e6), "us"),
        "wf_start_offset": 0.0,
        "wf_samples": sweep.samples,
    }
    channels = []
    if sweep.sample_times_s is None:
        waveform["wf_increment"] = 1.0 / sweep.sample_rate
    else:
        own = {**settings, "unit_string": "s"}
        channels.append(ChannelObject(group, "time_s", sweep.time_s, properties=own))
    channels += [
        ChannelObject(group, name, values, properties={**settings, **waveform})
        for name, values in piece.channels.items()
    ]
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([
            RootObject(properties={"name": path.stem, "schema": settings["schema"]}),
            GroupObject(group, properties=settings), *channels,
        ])
