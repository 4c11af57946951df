"""A small virtual instrument, measured and calibrated once for all tests, and the program to compare with."""

import json
import os
import subprocess
from pathlib import Path

import pytest

import ommatidia

# Two lenses on 50 x 70 pixels: every step takes a second or less.
SMALL = """
[sensor]
rows = 50
cols = 70
[array]
rows = 1
cols = 2
pitch_px = 20.0
placement_rms_px = 0.3
[optics]
aperture_um = 20.0
psf_window_px = 13
object_distance_um = 300.0
psf_field_px = 31
[object]
rows = 18
cols = 22
pixel_um = 2.8
[scan]
rows = 5
cols = 5
[stacks]
dark_frames = 4
flat_frames = 4
scene_frames = 3
"""


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """A folder with `small.toml`, `session` and `lab.instrument`."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "small.toml").write_text(SMALL)
    session = ommatidia.Session.bench(folder / "session", config=folder / "small.toml", seed=7)
    ommatidia.Instrument.calibrate(session).save(folder / "lab.instrument")
    return folder


@pytest.fixture(scope="session")
def instrument(lab):
    return ommatidia.Instrument.load(lab / "lab.instrument")


@pytest.fixture(scope="session")
def session(lab):
    return ommatidia.Session.open(lab / "session")


@pytest.fixture(scope="session")
def objects(session):
    """The objects of the scenes, [n, rows, cols]."""
    import numpy as np

    (scenes,) = session.stacks_of("scene")
    return np.stack([scenes.truth(i) for i in range(len(scenes))])


@pytest.fixture(scope="session")
def program():
    """Runs the program with `--json` and gives what it prints."""
    path = os.environ.get("OMMATIDIA_PROGRAM")
    if not path:
        pytest.skip("OMMATIDIA_PROGRAM does not name the program to compare with")

    def run(*words, cwd):
        done = subprocess.run([path, *map(str, words), "--json"], cwd=cwd, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        printed = json.loads(done.stdout)
        # What the package returns is of a function, not of a verb.
        assert printed.pop("verb").split()[0] == words[0]
        return printed

    run.path = Path(path)
    return run


@pytest.fixture(scope="session")
def checkpoint(lab, program):
    """A network after a few steps of training: its quality does not matter here."""
    path = lab / "net.checkpoint"
    program("train", "lab.instrument", "-o", path, "--steps", 4, cwd=lab)
    return path
