"""Run files that HDF5 allows and no run should be: links, bombs, wrong types, empty things."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

SWEEP: dict[str, Any] = {
    "sample_rate": 1000.0, "gain": 7.5, "offset_v": 75.0, "sensitivity_um_per_v": 15.48,
    "polarity": -1, "zero_v": 0.0, "condition": "0-60", "repeat": 1, "history": "virgin",
    "start_time": 1.0, "origin": "IMPORTED", "oversampling": 1,
}  # fmt: skip
HUGE = 1 << 44


def write_plain(path: Path, sweeps: int = 1, samples: int = 24, libver: Any = "earliest") -> Path:
    """A small imported run; ``earliest`` writes headers without checksums, which spoil deeper."""
    with h5py.File(path, "w", libver=libver) as f:
        f.attrs.update(NX_class="NXroot", default="entry")
        entry = f.create_group("entry")
        entry.attrs.update(NX_class="NXentry", default="loop", schema_version=1,
                           origin="IMPORTED", complete=True, planned_sweeps=sweeps)
        entry["title"] = "small"
        entry["notes"] = "made for study"
        for k in range(sweeps):
            group = entry.create_group(f"sweep_{k + 1:04d}")
            group.attrs.update({**SWEEP, "repeat": k + 1, "start_time": 1.0 + k})
            rise = 30 * (1 - np.cos(2 * np.pi * np.arange(samples) / samples))
            for name, values in (
                ("command_v", (rise - 75) / 7.5), ("sensor_v", -0.01 * rise),
                ("drive_monitor_v", rise),
            ):
                made = group.create_dataset(
                    name, data=values, chunks=(samples,), shuffle=True, compression="gzip",
                    fletcher32=True,
                )
                made.attrs["units"] = "V"
        loop = entry.create_group("loop")
        loop.attrs["sweep"] = "sweep_0001"
        loop["displacement"] = 0.1548 * rise
        loop["drive_voltage"] = rise
    return path


def _row(f: h5py.File, **options: Any) -> None:
    """The sensor's row made otherwise."""
    group = f["entry/sweep_0001"]
    del group["sensor_v"]
    group.create_dataset("sensor_v", **options).attrs["units"] = "V"


def _all_huge(f: h5py.File) -> None:
    group = f["entry/sweep_0001"]
    for name in ("command_v", "sensor_v", "drive_monitor_v"):
        del group[name]
        group.create_dataset(name, shape=(HUGE,), dtype="f4", chunks=(1 << 20,), fillvalue=1.0)
        group[name].attrs["units"] = "V"


def _many_medium(f: h5py.File) -> None:
    entry = f["entry"]
    for k in range(1, 100):
        group = entry.create_group(f"sweep_{k + 1:04d}")
        group.attrs.update(SWEEP)
        for name in ("command_v", "sensor_v"):
            group.create_dataset(name, shape=(2_000_000,), dtype="f8", chunks=(1 << 20,),
                                 compression="gzip")


def _swelling(f: h5py.File) -> None:
    """A packed piece of which every byte becomes a thousand."""
    _row(f, shape=(24,), dtype="f4", chunks=(24,), compression="gzip")
    packer, zeros = zlib.compressobj(9), bytes(1_000_000)
    packed = b"".join([packer.compress(zeros) for _ in range(150)] + [packer.flush()])
    f["entry/sweep_0001/sensor_v"].id.write_direct_chunk((0,), packed)


def _packed_zeros(f: h5py.File) -> None:
    """Honest about its size, which is a thousand times that of the file."""
    group = f["entry/sweep_0001"]
    for name in ("command_v", "sensor_v", "drive_monitor_v"):
        del group[name]
        made = group.create_dataset(name, shape=(30 << 20,), dtype="f4", chunks=(1 << 20,),
                                    compression="gzip", compression_opts=9)
        made.attrs["units"] = "V"
        packed = zlib.compress(bytes(4 << 20), 9)
        for k in range(30):
            made.id.write_direct_chunk((k << 20,), packed)


def _virtual(f: h5py.File) -> None:
    group = f["entry/sweep_0001"]
    del group["sensor_v"]
    layout = h5py.VirtualLayout(shape=(24,), dtype="f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "x", shape=(24,))
    group.create_virtual_dataset("sensor_v", layout, fillvalue=0.0)


def _outside(target: str) -> Callable[[h5py.File], None]:
    return lambda f: _row(f, shape=(24,), dtype="u1", external=[(target, 0, 24)])


def _replace(place: str, value: Any) -> Callable[[h5py.File], None]:
    def do(f: h5py.File) -> None:
        del f[place]
        f[place] = value

    return do


def _loops(f: h5py.File) -> None:
    f["entry/sweep_0002"] = h5py.SoftLink("/entry/sweep_0003")
    f["entry/sweep_0003"] = h5py.SoftLink("/entry/sweep_0002")
    f["entry/sweep_0004"] = f["entry"]  # a hard link upwards
    f["entry/instrument"] = f["entry"]


def _deep(f: h5py.File) -> None:
    group = f["entry"].create_group("instrument")
    for _ in range(1500):
        group = group.create_group("g")


def _wide(f: h5py.File) -> None:
    for k in range(2000):
        f["entry"][f"sweep_x{k:05d}"] = f["entry/sweep_0001"]


def _attributes(**values: Any) -> Callable[[h5py.File], None]:
    def do(f: h5py.File) -> None:
        for place in ("entry", "entry/sweep_0001"):
            for key, value in values.items():
                f[place].attrs[key] = value

    return do


def _strange_attributes(f: h5py.File) -> None:
    a = f["entry/sweep_0001"].attrs
    a["gain"] = h5py.Empty("f8")
    a["condition"] = np.array(["a", "b"], dtype=h5py.string_dtype())
    a["repeat"] = np.complex128(1j)
    a["history"] = f["entry"].ref
    a["condition_x"] = np.zeros(3, dtype=[("a", "f4"), ("b", "S3")])


def _texts(f: h5py.File) -> None:
    for name, value in (("event_log", np.frombuffer(b'{"time_s": 1e999}\n[]\n' * 9, "u1")),
                        ("wire_transcript", np.frombuffer(b"\xff" * 99, "u1"))):
        f["entry"][name] = value
    f["entry/rig_config"] = "[" * 3000
    f["entry/calibrations"] = "[" * 100_000
    f["entry/calibration_texts"] = "{" * 100_000
    f["entry/protocol_text"] = "x"
    f["entry"].attrs["origin"] = "REAL"


def _terminal(f: h5py.File) -> None:
    _attributes(condition="\x1b[2J\x1b]0;hi\x07" + "x" * 5000)(f)
    f["entry/title"][()] = "\x1b[2J"


def _tiny_chunks(f: h5py.File) -> None:
    _row(f, shape=(8_000_000,), dtype="f8", chunks=(1,))


HOSTILE: dict[str, Callable[[h5py.File], None]] = {
    "huge shapes, nothing written": _all_huge,
    "many medium shapes": _many_medium,
    "a packed piece that swells": _swelling,
    "packed zeros": _packed_zeros,
    "a contiguous row never written": lambda f: _row(f, shape=(HUGE,), dtype="f8"),
    "tiny chunks": _tiny_chunks,
    "one huge chunk": lambda f: _row(f, shape=(24,), dtype="f8", maxshape=(None,),
                                     chunks=(1 << 28,)),
    "no samples": lambda f: _row(f, shape=(0,), dtype="f8"),
    "no shape": lambda f: _row(f, data=h5py.Empty("f8")),
    "a scalar": lambda f: _row(f, data=1.0),
    "three dimensions": lambda f: _row(f, shape=(2, 3, 4), dtype="f8"),
    "many empty dimensions": lambda f: _row(f, shape=(1,) * 20, dtype="f8"),
    "texts": lambda f: _row(f, data=["a"] * 24, dtype=h5py.string_dtype()),
    "rows of rows": lambda f: _row(f, shape=(24,), dtype=h5py.vlen_dtype("f8")),
    "compounds": lambda f: _row(f, shape=(24,), dtype=[("a", "f8"), ("b", "S9")]),
    "references": lambda f: _row(f, shape=(24,), dtype=h5py.ref_dtype),
    "opaque": lambda f: _row(f, data=np.zeros(24, "V800000")),
    "array elements": lambda f: _row(f, shape=(24,), dtype=np.dtype(("f8", (1000,)))),
    "booleans": lambda f: _row(f, data=np.zeros(24, bool)),
    "complex numbers": lambda f: _row(f, data=np.zeros(24, complex)),
    "big integers": lambda f: _row(f, data=np.full(24, 2**64 - 1, np.uint64)),
    "half numbers": lambda f: _row(f, data=np.zeros(24, np.float16)),
    "large numbers": lambda f: _row(f, data=np.full(24, 1e308)),
    "another filter": lambda f: _row(f, data=np.zeros(24), chunks=(24,), compression="lzf"),
    "scale and offset": lambda f: _row(f, data=np.zeros(24, int), chunks=(24,), scaleoffset=0),
    "a virtual row": _virtual,
    "a row in a file of the system": _outside("/etc/passwd"),
    "a row in endless zeros": _outside("/dev/zero"),
    "a soft link": _replace("entry/sweep_0001/sensor_v", h5py.SoftLink("/entry/loop")),
    "a link into another file": _replace(
        "entry/sweep_0001", h5py.ExternalLink("/etc/passwd", "/x")
    ),
    "a link to a device": _replace("entry/sweep_0001", h5py.ExternalLink("/dev/zero", "/")),
    "the entry elsewhere": _replace("entry", h5py.ExternalLink("other.h5", "/entry")),
    "the entry is itself": _replace("entry", h5py.SoftLink("/entry")),
    "the entry is a row": _replace("entry", [1.0]),
    "loops of links": _loops,
    "deep groups": _deep,
    "one sweep under two thousand names": _wide,
    "a sweep is a type": _replace("entry/sweep_0001", np.dtype("f8")),
    "strange attributes": _strange_attributes,
    "long attributes": _attributes(condition="x" * 60_000, gain=np.zeros(6000)),
    "numbers that are none": _attributes(gain=float("nan"), sample_rate=float("inf"),
                                         schema_version=1),
    "too large numbers": _attributes(gain=1e308, offset_v=-1e308, oversampling=2**62),
    "negative numbers": _attributes(gain=-7.5, sample_rate=-1.0, planned_sweeps=-5),
    "a schema that is a text": _attributes(schema_version="1"),
    "many planned sweeps": _attributes(planned_sweeps=2**62, complete=True),
    "texts that are no texts": _texts,
    "texts for a terminal": _terminal,
}  # fmt: skip


def write_hostile(name: str, path: Path) -> Path:
    """The file of that name."""
    write_plain(path, sweeps=1)
    with h5py.File(path, "r+") as f:
        HOSTILE[name](f)
    return path
