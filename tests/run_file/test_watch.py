"""`piezo-rig watch`: a run that another process records, followed without touching it."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_run import small_run

from drivers.clock import VirtualClock
from piezo_rig.cli import main
from piezo_rig.commands.watch import follow
from piezo_rig.errors import InputError
from piezo_rig.run_file.live import latest, look
from piezo_rig.run_file.reader import Run
from tests.more import first_of

HERE = Path(__file__).parent

# A writer that does one thing for every line that it is told.
WRITER = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(HERE)!r})
from test_run_file import HEADER
from small_run import sweep
from piezo_rig.run_file.layout import SweepHeader
from piezo_rig.run_file.writer import RunWriter
sweeps = [sweep(k, "0-65", k, 65.0) for k in (1, 1, 2)]
headers = [
    SweepHeader(f"sweep_{{k + 1:04d}}", s.samples, s.sample_rate, s.gain, s.offset_v,
                s.sensitivity_um_per_v, s.polarity, "0-65", k + 1, "virgin")
    for k, s in enumerate(sweeps)
]
writer = RunWriter(Path(sys.argv[1]), HEADER, headers)
print("ready", flush=True)
for line in sys.stdin:
    word, k = line.split()
    k = int(k)
    if word == "store":
        s = sweeps[k]
        writer.log(10.0 * k, "playing", sweep=headers[k].name, condition="0-65", repeat=k + 1)
        sensor = s.sensor_v + (0.001 * (-1.0) ** __import__("numpy").arange(s.samples) if k else 0)
        writer.write_sweep(k, s.command_v, sensor, s.drive_monitor_v, 10.0 * k)
    elif word == "flag":
        writer.log(10.0 * k, "flag", code="beam-interruption", sweep=headers[k].name,
                   what="the beam is lost\\x1b[2J", first=0, count=1, usable=False)
    elif word == "close":
        writer.finish()
    print("done", flush=True)
"""


class Bench:
    """The writer's process, and a clock that lets it do its next thing while others sleep."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.path = folder / "r.h5"
        self.words = list(words)
        self.time = 0.0
        self.process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(self.path)], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        assert self.process.stdout.readline() == "ready\n"

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> float:
        self.time += seconds
        assert self.time < 100.0, "watched for ever"
        if self.words:
            self.do(self.words.pop(0))
        return self.time

    def do(self, word: str) -> None:
        if word == "kill":
            self.process.kill()
            self.process.wait()
            return
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def watched(bench, given=None, screen=None):
    screen = screen or io.StringIO()
    follow(given or bench.path, screen, bench)
    return screen.getvalue()


def test_a_recording_is_followed_to_its_end_sweep_by_sweep(tmp_path):
    with Bench(tmp_path, "store 0", "store 1", "flag 1", "store 2", "close 0") as bench:
        lines = watched(bench).splitlines()
    assert "recording, 0 of 3 sweeps stored" in lines[0]
    first, second, flag, third, end = lines[1:]
    assert first.startswith("sweep_0001  0-65, repeat 1: 0.00 .. 65.00 V, travel ")
    assert "needs a repeat or a hold; 1 of 3, about " in first
    # 1 mV up and down on one of two repeats, at 3.87 um/V: 3.87 nm / sqrt 2
    assert "noise 2.7 nm between repeats; 2 of 3" in second
    assert flag == "flag[beam-interruption]: sweep_0002: the beam is lost?[2J"
    assert third.startswith("sweep_0003")
    assert end == f"run: {bench.path} (closed, complete, 3 of 3 sweeps)"


def test_the_writer_is_not_stopped_by_a_reader_that_holds_the_file_open(tmp_path):
    import h5py

    with Bench(tmp_path) as bench:
        part = tmp_path / "r.part.h5"
        with h5py.File(part, "r", swmr=True, locking=False):
            for word in ("store 0", "store 1", "store 2", "close 0"):
                bench.do(word)
    assert Run(bench.path).complete


def test_a_look_takes_no_lock_on_what_is_being_recorded(tmp_path):
    import fcntl

    with Bench(tmp_path) as bench:
        bench.do("store 0")
        bench.do("kill")
        with (tmp_path / "r.part.h5").open("rb") as handle:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody else can lock it now
            seen = look(bench.path)
            assert latest(seen)[0].samples == 500


def test_a_terminal_shows_the_loop_and_what_is_left(tmp_path):
    with Bench(tmp_path, "store 0", "flag 0", "store 1", "store 2", "close 0") as bench:
        text = watched(bench, tmp_path, Terminal())
    pictures = text.split("\x1b[H")
    assert "displacement of 0-65, um" in pictures[-1]
    assert "\u28c0" in pictures[-1]
    assert any("flag[beam-interruption]: sweep_0001" in p for p in pictures)
    assert "1 flags in all" in pictures[-1]
    assert "no flags of beam, sensor or drive" in pictures[-1]
    assert "closed, complete, 3 of 3 sweeps" in pictures[-1]


def test_a_writer_that_was_killed_is_noticed(tmp_path):
    if not Path("/proc/locks").exists():
        pytest.skip("this system does not list its locks")
    with Bench(tmp_path, "store 0", "kill") as bench:
        text = watched(bench)
    assert "no program records it any more; it was killed" in text.splitlines()[-1]
    assert 10.0 < bench.time < 20.0


def test_a_run_that_was_broken_off_ends_with_what_its_log_says(tmp_path):
    with Bench(tmp_path, "store 0", "close 0") as bench:
        lines = watched(bench).splitlines()
    assert lines[-2:] == [f"run: {bench.path} (closed, INCOMPLETE, 1 of 3 sweeps)",
                          "at rest after sweep_0001"]


def test_the_time_left_follows_the_pace_of_what_is_stored(tmp_path):
    with Bench(tmp_path) as bench:
        assert look(bench.path).seconds_left(0.0) is None
        bench.do("store 0")
        bench.do("store 1")
        seen = look(bench.path)
    # one sweep of 0.3 s is left; the two before took 10.25 s with what was between them, from 0
    took = 10.0 + 0.25 - seen.clock_start
    last = seen.stored[-1].stored_at
    pace = (last - seen.stored[0].stored_at) / 10.0
    expected = pace * (0.3 + (took - 0.5) / 2.0)
    assert seen.seconds_left(last) == pytest.approx(expected)
    assert seen.seconds_left(last + 1e6) == 0.0


def test_a_finished_run_is_shown_once(tmp_path, capsys):
    path = small_run(tmp_path)
    assert main(["watch", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert lines[1].startswith("sweep_0004  0-65, repeat 3")
    assert lines[2] == f"run: {path} (closed, complete, 3 of 4 sweeps)"


class Late:
    """A bench whose run begins only after five looks."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.time = 0.0
        self.bench: Bench | None = None

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> float:
        self.time += seconds
        if self.bench is not None:
            self.bench.sleep(seconds)
        elif self.time >= 5.0:
            self.folder.mkdir(exist_ok=True)
            self.bench = Bench(self.folder, "store 0", "store 1", "store 2", "close 0")
        return self.time

    def __enter__(self) -> Late:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bench is not None:
            self.bench.__exit__()


@pytest.mark.parametrize(("there", "given"), first_of(1, [
    ("an older run", ""), ("an empty folder", ""), ("nothing", "r.h5"),
]))  # fmt: skip
def test_a_run_that_is_about_to_begin_is_waited_for(there, given, tmp_path):
    folder = tmp_path / "runs"
    if there != "nothing":
        folder.mkdir()
    if there == "an older run":
        small_run(folder).rename(folder / "older.h5")
    with Late(folder) as bench:
        lines = watched(bench, folder / given).splitlines()
    assert lines[0].startswith(f"{folder / given}: ")
    assert "waiting 30 s for a run to begin" in lines[0]
    assert "recording, " in lines[1]
    assert lines[-1] == f"run: {folder / 'r.h5'} (closed, complete, 3 of 3 sweeps)"


def test_a_folder_in_which_nothing_begins_shows_the_end_of_its_latest_run(tmp_path):
    path, clock, screen = small_run(tmp_path), VirtualClock(), io.StringIO()
    follow(tmp_path, screen, clock)
    waiting, *_, end = screen.getvalue().splitlines()
    assert waiting.startswith(f"{tmp_path}: nothing is being recorded there; waiting 30 s")
    assert end == f"run: {path} (closed, complete, 3 of 4 sweeps)"
    assert clock.now() == pytest.approx(30.0)


@pytest.mark.parametrize(("given", "said"), [
    ("", "holds no run"), ("nothing.h5", "no such run"), ("nothing", "no such run"),
    ("w.log", "not a run file"), ("text.h5", "cannot be read as a run"),
])  # fmt: skip
def test_what_is_no_run_is_said_by_the_name_that_was_given(given, said, tmp_path):
    for name in ("w.log", "text.h5"):
        (tmp_path / name).write_text("a text")
    folder = tmp_path / "folder"
    folder.mkdir()
    path = tmp_path / given if given else folder
    with pytest.raises(InputError) as refused:
        follow(path, io.StringIO(), VirtualClock())
    assert refused.value.what.startswith(f"{path}: {said}")


def test_ctrl_c_ends_the_waiting(tmp_path):
    class Impatient(VirtualClock):
        def sleep(self, seconds: float) -> float:
            raise KeyboardInterrupt

    screen = io.StringIO()
    follow(tmp_path, screen, Impatient())
    assert screen.getvalue().splitlines()[-1] == "waiting ended; nothing has begun"


def test_ctrl_c_ends_the_watching_only(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("piezo_rig.commands.watch.follow", interrupted)
    assert main(["watch", str(tmp_path)]) == 0
    assert "the recording goes on" in capsys.readouterr().out
