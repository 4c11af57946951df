#!/usr/bin/env python3
"""Writes a synthetic recording of 20 minutes in the layout of a Miniscope V4: 24 AVIs of 1000 frames at 20 Hz, with
timeStamps.csv and metaData.json. The recorder missed 40 frames after frame 7100 and 3 after frame 15300; 11.avi lacks
its last 200 frames, and 23.avi ends within its last frame, as after a crash.

    python3 tests/formats/miniscope.py FOLDER [SIDE] [--ffv1]

SIDE is that of a frame, 208 pixels by default: 1.04 GB. With --ffv1 frames are compressed as the recorder does it, with
60 frames a second in the heads of the files, and some bytes of 5.avi are damaged; ffmpeg must be on the path. Needs
numpy.
"""
import argparse
import json
import pathlib
import struct
import subprocess
import tempfile

import numpy as np

FILES, PER_FILE, RATE_HZ = 24, 1000, 20
GAPS = {7100: 40, 15300: 3}
SHORT = {11: 800}
TORN = 23
DAMAGED = 5


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


def ffv1(frames, side):
    """The same, compressed by ffmpeg without loss."""
    command = ["ffmpeg", "-v", "error", "-f", "rawvideo", "-pix_fmt", "gray", "-s", f"{side}x{side}", "-r", "60"]
    coding = ["-c:v", "ffv1", "-level", "3", "-slicecrc", "1", "-f", "avi"]
    # An AVI cannot be written into a pipe: its length is filled in at the end.
    with tempfile.NamedTemporaryFile(suffix=".avi") as file:
        subprocess.run([*command, "-i", "-", *coding, "-y", file.name], input=b"".join(frames), check=True)
        return pathlib.Path(file.name).read_bytes()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("side", type=int, nargs="?", default=208)
    parser.add_argument("--ffv1", action="store_true")
    given = parser.parse_args()
    folder, side = given.folder, given.side
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
        data = ffv1(frames, side) if given.ffv1 else avi(frames, side)
        if file == TORN:
            # Without the index and a part of the last frame.
            data = data[: data.rindex(b"idx1") - side * side // (8 if given.ffv1 else 2)]
        if file == DAMAGED and given.ffv1:
            at = len(data) // 3
            data = data[:at] + bytes(16) + data[at + 16 :]
        (folder / f"{file}.avi").write_bytes(data)
    rows, step = ["Frame Number,Time Stamp (ms),Buffer Index"], 0
    for i in range(FILES * PER_FILE):
        # Whole milliseconds, of 50.5 from one frame to the next.
        rows.append(f"{i},{int(50.5 * step) - 3},0")
        step += 1 + GAPS.get(i, 0)
    (folder / "timeStamps.csv").write_bytes("\r\n".join([*rows, ""]).encode())
    metadata = {
        "ROI": {"height": side, "leftEdge": 0, "topEdge": 0, "width": side}, "compression": "FFV1" if given.ffv1 else "GREY",
        "deviceName": "Miniscope", "deviceType": "Miniscope_V4_BNO", "frameRate": f"{RATE_HZ}FPS",
        "framesPerFile": PER_FILE, "gain": "Low", "led0": 15,
    }
    (folder / "metaData.json").write_text(json.dumps(metadata, indent=4))


if __name__ == "__main__":
    main()
