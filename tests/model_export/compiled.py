"""Compiles an exported step function and plays drives through it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from piezo_rig.model_export import c_source

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
MAIN = """
#include <stdio.h>
static struct stage_test state;
int main(void)
{
    double drive, moved;
    int fault = 0;
    unsigned long forgotten = 0;
    stage_test_init(&state);
    while (fread(&drive, sizeof drive, 1, stdin) == 1) {
        if (drive > 1e290) { stage_test_init(&state); continue; }
        moved = stage_test_step(&state, drive);
        fault |= state.fault;
        forgotten += state.forgotten > forgotten ? state.forgotten - forgotten : 0;
        fwrite(&moved, sizeof moved, 1, stdout);
    }
    fprintf(stderr, "%d %lu", fault, forgotten);
    return 0;
}
"""
FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
AGAIN = 1e295


class Compiled:
    """A model's step function as a program; ``fault`` and ``forgotten`` are its last state's."""

    def __init__(self, model, folder: Path, rate: float) -> None:
        if COMPILER is None:
            pytest.skip("no C compiler here")
        self.source = c_source(model, "stage_test", rate)
        (folder / "model.c").write_text(self.source.text)
        (folder / "main.c").write_text('#include "model.c"\n' + MAIN)
        self.program = folder / "program"
        subprocess.run([COMPILER, *FLAGS, "main.c", "-o", "program", "-lm"], cwd=folder, check=True)
        self.fault = self.forgotten = 0

    def play(self, *drives):
        """The displacement of each drive; the state begins anew with each."""
        sent = np.concatenate([np.append(d, AGAIN) for d in drives]).tobytes()
        done = subprocess.run([self.program], input=sent, capture_output=True, check=True)
        self.fault, self.forgotten = map(int, done.stderr.split())
        moved = np.frombuffer(done.stdout)
        return np.split(moved, np.cumsum([d.size for d in drives])[:-1])
