"""Counts the instructions of CMSIS-NN's 3x3 convolutions in integers, for docs/instructions.md.

Usage: python3 count.py CMSIS-NN [--cc arm-none-eabi-gcc] [--qemu qemu-system-arm]

CMSIS-NN is the folder of a release (https://github.com/ARM-software/CMSIS-NN). Needs a compiler for Cortex-M with a C
library (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi), `cc` and QEMU. Prints one row of a table for each core and
shape: 48 x 48 pixels, 16 or 32 channels in and out, features of 8 bits (s8) and of 16 (s16), weights of 8. Of two
levels of optimisation the better one counts. The counter is that of `ommatidia device bench`. Exit code 1 where the
library's result is not that of a plain loop.
"""

import argparse
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
COUNTER = HERE.parents[1] / "host/program/src/device/counter.c"
# Machine of QEMU, core, and the memory of data; the program lies at 0.
BOARDS = [("mps2-an500", "cortex-m7", 4096), ("mps3-an547", "cortex-m55", 512), ("mps2-an386", "cortex-m4", 4096)]
LEVELS = ["-O2", "-Ofast"]
LAYOUT = """
MEMORY {{ CODE : ORIGIN = 0, LENGTH = 512K   DATA : ORIGIN = 0x20000000, LENGTH = {data}K }}
stack_end = ORIGIN(DATA) + LENGTH(DATA);
SECTIONS {{
  .text : {{ KEEP(*(.vectors)) *(.text*) *(.rodata*) *(.ARM.ex*) }} > CODE
  .data : {{ *(.data*) *(.bss*) *(COMMON) }} > DATA
}}
"""


def run(command):
    """Runs a program; a failure ends the script with its words."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"`{command[0]}` fails: {(done.stderr or done.stdout).strip()[-2000:]}")
    return done.stdout + done.stderr


def build_counter(qemu, folder):
    """The plugin of QEMU, built for the interface that this QEMU has."""
    for declared in range(1, 8):
        plugin, answer = folder / "counter.so", folder / "answer"
        run(["cc", "-O2", "-fPIC", "-shared", f"-DDECLARED={declared}", "-o", plugin, COUNTER, "-ldl"])
        ask = ["-M", "none", "-display", "none", "-monitor", "none", "-serial", "none"]
        subprocess.run([qemu, *ask, "-plugin", f"{plugin},ask={answer}"], capture_output=True, timeout=20, check=False)
        if answer.exists():
            return plugin
    sys.exit(f"`{qemu}` takes no plugin whose interface is known; see host/program/src/device/counter.c")


def library(sources, options, core, level, folder):
    """The object files of the library; functions that are not called are left out when they are linked."""
    common = [options.cc, "-c", f"-mcpu={core}", "-mthumb", "-mfloat-abi=hard", level, "-ffunction-sections"]
    objects = folder / f"{core}{level}"
    objects.mkdir()
    for source in sources:
        run([*common, "-I", options.library / "Include", "-o", objects / f"{source.stem}.o", source])
    return sorted(objects.glob("*.o"))


def count(board, objects, case, options, plugin, folder):
    """Instructions of one convolution, and whether its result is right."""
    machine, core, data = board
    level, channels, wide = case
    layout, image, counts = folder / "layout.ld", folder / "image.elf", folder / "counts"
    layout.write_text(LAYOUT.format(data=data))
    flags = [f"-mcpu={core}", "-mthumb", "-mfloat-abi=hard", level, f"-DCHANNELS={channels}", f"-DS16={int(wide)}"]
    flags += ["-I", options.library / "Include", "-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections"]
    run([options.cc, *flags, "-T", layout, "-o", image, HERE / "convolution.c", *objects])
    qemu = [options.qemu, "-M", machine, "-display", "none", "-monitor", "none", "-serial", "none"]
    qemu += ["-semihosting-config", "enable=on,target=native", "-plugin", f"{plugin},out={counts}", "-kernel", image]
    said = run(qemu).strip()
    if said != "right":
        sys.exit(f"{core}, {channels} channels: {said}")
    return int(counts.read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=pathlib.Path, help="folder of a release of CMSIS-NN")
    parser.add_argument("--cc", default="arm-none-eabi-gcc")
    parser.add_argument("--qemu", default="qemu-system-arm")
    options = parser.parse_args()
    folders = ["ConvolutionFunctions", "NNSupportFunctions"]
    sources = [path for name in folders for path in sorted((options.library / "Source" / name).glob("*.c"))]
    # Floats and weights of 4 bits are not counted.
    sources = [path for path in sources if not path.stem.endswith(("_f16", "_f32", "_s4", "_flt"))]
    if not sources:
        sys.exit(f"{options.library}: it has no Source/{folders[0]}; give the folder of a release of CMSIS-NN")
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        plugin = build_counter(options.qemu, folder)
        print("| core | 3x3 convolution, 48x48 | instructions | per MAC |\n|---|---|---|---|")
        for board in BOARDS:
            objects = {level: library(sources, options, board[1], level, folder) for level in LEVELS}
            for channels in [16, 32]:
                for wide in [False, True]:
                    cases = [(level, channels, wide) for level in LEVELS]
                    best = min(count(board, objects[case[0]], case, options, plugin, folder) for case in cases)
                    kind, work = "s16" if wide else "s8", 9 * channels * channels * 48 * 48
                    print(f"| {board[1]} | {channels}->{channels}, {kind} | {best} | {best / work:.2f} |", flush=True)


if __name__ == "__main__":
    main()
