"""Time of `predict` a frame: the program against the package, in turns, at several sizes.

    python host/python/scripts/speed.py target/release/ommatidia

Both plan once and predict the same objects. The program says how long a frame took (`seconds_per_frame`), in which it
also reads an object and writes a frame; the package is timed with the call and its array. The ratio of a size is the
median over turns of package over program, one after the other, so that what else the machine does befalls both.
Everything runs in a temporary folder.
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import ommatidia

SIZES = {
    "50 x 70, 2 lenses": """
[sensor]
rows = 50
cols = 70
[array]
rows = 1
cols = 2
pitch_px = 20.0
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
""",
    "the usual instrument": "",
}


def turns(program, text, frames, count):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "bench.toml").write_text(text)
        instrument = ommatidia.Instrument.calibrate(folder / "bench.toml", rank=8, replicates=0)
        instrument.save(folder / "a.instrument")
        objects = np.random.default_rng(1).random((frames, *instrument.object_shape), dtype=np.float32) * 1e-3
        np.save(folder / "objects.npy", objects)
        out, found = folder / "out.npy", []
        expected = instrument.predict(objects)  # plans
        for _ in range(count):
            words = [program, "predict", folder / "a.instrument", folder / "objects.npy", "-o", out]
            words += ["--json", "--force"]
            printed = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
            start = time.perf_counter()
            mine = instrument.predict(objects)
            package = (time.perf_counter() - start) / frames
            assert np.array_equal(np.load(out), expected) and np.array_equal(mine, expected)
            found.append((printed["seconds_per_frame"], package))
        return instrument.sensor_shape, found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--turns", type=int, default=9)
    options = parser.parse_args()
    print(f"{'size':<24} {'program, ms':>12} {'package, ms':>12} {'ratio':>7} {'smallest':>9} {'largest':>8}")
    for name, text in SIZES.items():
        shape, found = turns(options.program, text, options.frames, options.turns)
        ratios = sorted(package / program for program, package in found)
        program, package = (1e3 * statistics.median(times) for times in zip(*found))
        name = f"{name} ({shape[0]} x {shape[1]})" if not text else name
        ratio = statistics.median(ratios)
        print(f"{name:<24} {program:>12.2f} {package:>12.2f} {ratio:>7.3f} {ratios[0]:>9.3f} {ratios[-1]:>8.3f}")


if __name__ == "__main__":
    main()
