#!/usr/bin/env python3
"""Writes a synthetic recording of 20 minutes in the layout of a Miniscope V4: 24 AVIs of 1000 frames at 20 Hz, with
timeStamps.csv and metaData.json. The recorder missed 40 frames after frame 7100 and 3 after frame 15300; 11.avi lacks
its last 200 frames, and 23.avi ends within its last frame, as after a crash.

    python3 tests/formats/miniscope.py FOLDER [SIDE]

SIDE is that of a frame, 208 pixels by default: 1.04 GB. Needs numpy.
"""
import json
import pathlib
import struct
import sys

import numpy as np

FILES, PER_FILE, RATE_HZ = 24, 1000, 20
GAPS = {7100: 40, 15300: 3}
SHORT = {11: 800}
TORN = 23


def chunk(name, data):
    return name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)


def listed(name, *inner):
    return chunk(b"LIST", name + b"".join(inner))


def avi(frames, side):
    """Grey frames as Miniscope-DAQ-QT writes them, with an index."""
    kind, frame = (b"vids", b"GREY", 0, 0, 0, 0), (0, 0, side, side)
    head = struct.pack("<4s4sIHHIIIIIIII4H", *kind, 1, RATE_HZ, 0, len(frames), 0, 0, 0, *frame)
    form = struct.pack("<IiiHH4sIiiII", 40, side, side, 1, 8, b"GREY", side * side, 0, 0, 0, 0)
    main = struct.pack("<14I", 1_000_000 // RATE_HZ, 0, 0, 16, len(frames), 0, 1, 0, side, side, 0, 0, 0, 0)
    headers = listed(b"hdrl", chunk(b"avih", main), listed(b"strl", chunk(b"strh", head), chunk(b"strf", form)))
    data = b"".join(chunk(b"00db", frame) for frame in frames)
    size = 8 + side * side + side * side % 2
    index = b"".join(struct.pack("<4sIII", b"00db", 16, 4 + i * size, side * side) for i in range(len(frames)))
    return chunk(b"RIFF", b"AVI " + headers + listed(b"movi", data) + chunk(b"idx1", index))


def main():
    folder = pathlib.Path(sys.argv[1])
    side = int(sys.argv[2]) if len(sys.argv) > 2 else 208
    folder.mkdir(parents=True)
    rng = np.random.default_rng(20)
    # Cells that flicker over a vignetted background, and noise that is different in each frame.
    y, x = np.mgrid[:side, :side] / side - 0.5
    background = 90 * np.exp(-4 * (x**2 + y**2))
    places = rng.uniform(-0.4, 0.4, (40, 2))
    cells = np.array([np.exp(-((y - r) ** 2 + (x - c) ** 2) / 2e-4) for r, c in places], "float32")
    noise = rng.normal(0, 3, (64, side, side)).astype("float32")
    light = np.zeros(len(cells), "float32")
    for file in range(FILES):
        frames = []
        for i in range(SHORT.get(file, PER_FILE)):
            light = 0.93 * light + 80 * (rng.random(len(cells)) < 0.01)
            frame = background + np.tensordot(light, cells, 1) + np.roll(noise[i % 64], 7 * i % side, 1)
            frames.append(np.clip(frame, 0, 255).astype("uint8").tobytes())
        data = avi(frames, side)
        if file == TORN:
            # Without the index and half of the last frame.
            data = data[: -(8 + 16 * len(frames)) - side * side // 2]
        (folder / f"{file}.avi").write_bytes(data)
    rows, step = ["Frame Number,Time Stamp (ms),Buffer Index"], 0
    for i in range(FILES * PER_FILE):
        # Whole milliseconds, of 50.5 from one frame to the next.
        rows.append(f"{i},{int(50.5 * step) - 3},0")
        step += 1 + GAPS.get(i, 0)
    (folder / "timeStamps.csv").write_bytes("\r\n".join([*rows, ""]).encode())
    metadata = {
        "ROI": {"height": side, "leftEdge": 0, "topEdge": 0, "width": side}, "compression": "GREY",
        "deviceName": "Miniscope", "deviceType": "Miniscope_V4_BNO", "frameRate": f"{RATE_HZ}FPS",
        "framesPerFile": PER_FILE, "gain": "Low", "led0": 15,
    }
    (folder / "metaData.json").write_text(json.dumps(metadata, indent=4))


if __name__ == "__main__":
    main()
