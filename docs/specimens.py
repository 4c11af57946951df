"""Pictures of specimens for `ommatidia arena --images`, written apart from the program's own specimens.

    python3 docs/specimens.py pictures

writes 24 grey pictures of 96 x 96 pixels each into pictures/beads (single pixels), pictures/filaments (lines of one
pixel) and pictures/texture (bodies with waves in them). Needs nothing but Python.
"""

import math
import os
import random
import struct
import sys
import zlib

SIDE = 96
COUNT = 24


def beads(draw):
    image = [[0.0] * SIDE for _ in range(SIDE)]
    for _ in range(draw.randint(15, 60)):
        image[draw.randrange(SIDE)][draw.randrange(SIDE)] = draw.uniform(40, 255)
    return image


def filaments(draw):
    image = [[0.0] * SIDE for _ in range(SIDE)]
    for _ in range(draw.randint(4, 12)):
        y, x, angle = draw.uniform(0, SIDE), draw.uniform(0, SIDE), draw.uniform(0, 2 * math.pi)
        light = draw.uniform(60, 255)
        for _ in range(160):
            if 0 <= int(y) < SIDE and 0 <= int(x) < SIDE:
                image[int(y)][int(x)] = max(image[int(y)][int(x)], light)
            angle += draw.gauss(0, 0.06)
            y, x = y + 0.8 * math.sin(angle), x + 0.8 * math.cos(angle)
    return image


def texture(draw):
    image = [[0.0] * SIDE for _ in range(SIDE)]
    for _ in range(draw.randint(3, 9)):
        row, col, radius = draw.uniform(5, SIDE - 5), draw.uniform(5, SIDE - 5), draw.uniform(5, 14)
        light = draw.uniform(80, 200)
        waves = [(draw.uniform(0.3, 1.6), draw.uniform(0, 6.3), draw.uniform(0, 6.3)) for _ in range(5)]
        for y in range(SIDE):
            for x in range(SIDE):
                distance = math.hypot(y - row, x - col)
                if distance < radius:
                    wave = sum(math.cos(k * (math.cos(a) * y + math.sin(a) * x) + p) for k, a, p in waves) / len(waves)
                    image[y][x] = max(image[y][x], light * (1 + 0.9 * wave) * min(1, radius - distance))
    return image


def chunk(kind, data):
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def write_png(path, image):
    rows = b"".join(b"\0" + bytes(int(max(0, min(255, v))) for v in row) for row in image)
    header = struct.pack(">IIBBBBB", len(image[0]), len(image), 8, 0, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header))
        file.write(chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    for kind in (beads, filaments, texture):
        folder = os.path.join(sys.argv[1], kind.__name__)
        os.makedirs(folder, exist_ok=True)
        for i in range(COUNT):
            write_png(os.path.join(folder, f"{i:02}.png"), kind(random.Random(7 * i + len(kind.__name__))))


main()
