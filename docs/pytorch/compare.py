"""Trains the reference network with PyTorch and with `ommatidia train`, on the same pairs from the same weights, and holds both against each other.

    cargo demo                                                         # makes pairs, instrument and session
    pip install torch numpy                                            # written with PyTorch 2.15
    python docs/pytorch/compare.py --demo demo -o comparison           # minutes; writes result.json, curves.svg, table.md

The network is written anew from the paper; names, order of operations and crop are those of the published one, so that `import-pth` reads it.
Both sides: the same initial weights, pairs, held-out frames, loss, optimiser, learning rates and number of steps; each draws its own noise and order.
"""

import argparse
import json
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as f

THREADS = 2
RATES = {"filters": 2e-4, "layers": 5e-3}  # highest learning rates, of preset `nano`
FINAL, WARMUP, POINTS = 0.02, 50, 20  # schedule of `ommatidia train`


def tensors(path):
    """Header and tensors of a safetensors file."""
    data = Path(path).read_bytes()
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:end])
    body = json.loads(header.pop("__metadata__")["ommatidia"])["body"]
    cut = lambda t: np.frombuffer(data[end:][slice(*t["data_offsets"])], np.float32).reshape(t["shape"])
    return body, {name: cut(t) for name, t in header.items()}


class Deconvolution(nn.Module):
    """Learned filters in frequency."""

    def __init__(self, channels, side, frame, obj):
        super().__init__()
        self.side, self.obj = side, obj
        rows, cols = ((side - n) // 2 for n in frame)
        self.pad = (cols, side - frame[1] - cols, rows, side - frame[0] - rows)
        self.psfs_re = nn.Parameter(torch.rand(channels, side, side // 2 + 1) * 0.001)
        self.psfs_im = nn.Parameter(torch.rand(channels, side, side // 2 + 1) * 0.001)

    def forward(self, x):
        y = torch.fft.rfft2(f.pad(x, self.pad)) * torch.complex(self.psfs_re, self.psfs_im)
        y = torch.fft.irfft2(y, s=(self.side, self.side))
        y = y / y.amax((1, 2, 3), keepdim=True)
        top, left = (self.side // 2 + 1 - n // 2 for n in self.obj)
        y = y[:, :, top : top + self.obj[0], left : left + self.obj[1]]
        return y / y.amax((1, 2, 3), keepdim=True)


def conv(inputs, outputs, side=3):
    layer = nn.Conv2d(inputs, outputs, side, padding=side // 2)
    nn.init.kaiming_normal_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


class Attention(nn.Module):
    def __init__(self, width, reduction):
        super().__init__()
        squeezed = width // reduction
        parts = [nn.AdaptiveAvgPool2d(1), conv(width, squeezed, 1), nn.ReLU(), conv(squeezed, width, 1), nn.Sigmoid()]
        self.module = nn.Sequential(*parts)

    def forward(self, x):
        return x * self.module(x)


class Residual(nn.Module):
    """Adds its input to what its parts make of it."""

    def __init__(self, *parts):
        super().__init__()
        self.module = nn.Sequential(*parts)

    def forward(self, x):
        return x + self.module(x)


class Enhancement(nn.Module):
    """The light RCAN."""

    def __init__(self, channels, width, groups, blocks, reduction):
        super().__init__()
        block = lambda: Residual(conv(width, width), nn.ReLU(), conv(width, width), Attention(width, reduction))
        group = lambda: Residual(*(block() for _ in range(blocks)), conv(width, width))
        self.downscale = nn.Sequential(nn.PixelUnshuffle(2), conv(4 * channels, width))
        self.rgs = nn.Sequential(*(group() for _ in range(groups)))
        self.conv1 = conv(width, width)
        self.upscale = nn.Sequential(conv(width, 4 * width), nn.PixelShuffle(2))
        self.conv2 = conv(width, 1)

    def forward(self, x):
        x = self.downscale(x)
        return self.conv2(self.upscale(x + self.conv1(self.rgs(x))))


class Network(nn.Module):
    """SV-FourierNet; gives logits."""

    def __init__(self, n):
        super().__init__()
        self.deconvolution = Deconvolution(n["channels"], n["filter_size"], n["frame"], n["object"])
        self.enhancement = Enhancement(n["channels"], n["width"], n["groups"], n["blocks"], n["reduction"])

    def forward(self, x):
        return self.enhancement(self.deconvolution(x))


def loss_of(logits, target):
    return f.binary_cross_entropy_with_logits(logits, target) + f.mse_loss(torch.sigmoid(logits), target)


class Data:
    """Pairs of the data set but those held out, noise drawn each time a pair is seen; and the held-out frames of a checkpoint."""

    def __init__(self, pairs, checkpoint):
        plan = json.loads((pairs / "dataset.json").read_text())
        body, held = tensors(checkpoint)
        self.noise, self.peak = plan["noise"], np.log(plan["peak_e"])
        self.offset, self.gain = held.get("sensor.offset_dn", 0.0), held.get("sensor.inverse_gain", 1.0)
        shards = [tensors(path)[1] for path in sorted(pairs.glob("shard-*.safetensors"))]
        self.frames, objects = (np.concatenate([s[name] for s in shards]) for name in ("frames_e", "objects"))
        self.objects = objects / objects.max((1, 2), keepdims=True)
        black = self.noise["black_level_dn"]
        dn = held["validation.frames_dn"].astype(np.float32) - np.float32(black)
        self.held = [self.pair(frame, truth) for frame, truth in zip(dn, held["validation.objects"])]
        seen = [i for i, o in enumerate(self.objects) if np.abs(o - held["validation.objects"]).max((1, 2)).min() > 1e-4]
        self.rng = np.random.default_rng(1)
        kept = len(self.objects) - round(body["training"]["held_out"] * len(self.objects))
        self.train, self.order = self.rng.permutation(seen)[:kept], []

    def pair(self, light, target):
        light = (light - self.offset) * self.gain
        return [torch.from_numpy(np.ascontiguousarray(a, np.float32))[None, None] for a in (light / light.max(), target)]

    def draw(self):
        if not len(self.order):
            self.order = self.rng.permutation(self.train).tolist()
        i, n = self.order.pop(), self.noise
        frame = self.frames[i] * np.exp(self.rng.uniform(*self.peak)) / self.frames[i].max()
        e = self.rng.poisson(frame.clip(0)) + n["read_noise_e"] * self.rng.standard_normal(frame.shape)
        code = np.round(n["black_level_dn"] + self.offset + n["gain_dn_per_e"] * e).clip(0, n["saturation_dn"])
        return self.pair(code - n["black_level_dn"], self.objects[i])


class Training:
    """One run of PyTorch."""

    def __init__(self, network, steps):
        self.network, filters = network, list(network.deconvolution.parameters())
        groups = [(filters, RATES["filters"]), (list(network.enhancement.parameters()), RATES["layers"])]
        self.adam = torch.optim.Adam([{"params": p, "lr": rate} for p, rate in groups])
        warm = max(steps // WARMUP, 1)
        cosine = lambda at: FINAL + (1 - FINAL) * 0.5 * (1 + np.cos(np.pi * min(at, 1.0)))
        rate = lambda step: (step + 1) / warm if step < warm else cosine((step - warm) / max(steps - warm, 1))
        self.schedule = torch.optim.lr_scheduler.LambdaLR(self.adam, rate)

    def step(self, frame, target):
        self.adam.zero_grad()
        loss = loss_of(self.network(frame), target)
        loss.backward()
        self.adam.step()
        self.schedule.step()
        return loss.item()


def train(network, data, steps):
    """Trains to the end: curve and best weights."""
    run, curve, recent, best = Training(network, steps), [], [], None
    for step in range(1, steps + 1):
        recent.append(run.step(*data.draw()))
        if step % max(steps // POINTS, 1) == 0 or step == steps:
            with torch.no_grad():
                held = statistics.mean(loss_of(network(x), t).item() for x, t in data.held)
            curve.append({"step": step, "train_loss": statistics.mean(recent), "validation_loss": held})
            print(curve[-1], flush=True)
            recent = []
            if best is None or held < best[0]:
                best = held, {name: t.clone() for name, t in network.state_dict().items()}
    return curve, best[1]


def svg(path, curves):
    """Held-out and training loss over steps, logarithmic."""
    width, height, left, colours = 640, 360, 60, {"ommatidia": "#0b6e4f", "PyTorch": "#c8553d"}
    every = [p[k] for c in curves.values() for p in c for k in ("train_loss", "validation_loss")]
    low, high, last = min(every) * 0.97, max(every) * 1.03, max(p["step"] for c in curves.values() for p in c)
    x = lambda step: left + (width - left - 20) * step / last
    y = lambda loss: 20 + (height - 70) * np.log(high / loss) / np.log(high / low)
    text = lambda px, py, s, more="": f'<text x="{px:.1f}" y="{py:.1f}" {more}>{s}</text>'
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">']
    out.append(f'<rect width="{width}" height="{height}" fill="white"/>')
    for tick in np.geomspace(low, high, 5):
        out.append(f'<path d="M{left} {y(tick):.1f}H{width - 20}" stroke="#ddd"/>')
        out.append(text(left - 6, y(tick) + 4, f"{tick:.3f}", 'text-anchor="end"'))
    for step in range(0, last + 1, max(last // 4, 1)):
        out.append(text(x(step), height - 32, step, 'text-anchor="middle"'))
    out.append(text((left + width) / 2, height - 12, "steps", 'text-anchor="middle"'))
    for row, (name, curve) in enumerate(curves.items()):
        for column, (key, dash) in enumerate([("validation_loss", ""), ("train_loss", "4 3")]):
            points = " ".join(f"{x(p['step']):.1f},{y(p[key]):.1f}" for p in curve)
            style = f'fill="none" stroke="{colours[name]}" stroke-width="2" stroke-dasharray="{dash}"'
            out.append(f'<polyline points="{points}" {style}/>')
            px, py = width - 330 + 170 * column, 40 + 18 * row
            out.append(f'<path d="M{px} {py - 4}h24" {style}/>')
            out.append(text(px + 30, py, f"{name}, {('held out', 'training')[column]}"))
    path.write_text("\n".join(out) + "\n</svg>\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demo", type=Path, required=True, help="folder of `cargo demo`: pairs, instrument, session")
    parser.add_argument("--program", default="target/release/ommatidia")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=5, help="of the race: both sides in turn")
    parser.add_argument("--race", type=int, default=200, help="steps of each side in a round")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    args.output.mkdir(exist_ok=True)
    torch.set_num_threads(THREADS)
    torch.manual_seed(1)
    at = lambda name: str(args.output / name)
    pairs, instrument = args.demo / "pairs", str(args.demo / "instrument.safetensors")

    def program(*words):
        line = [args.program, "--json", "--quiet", "--threads", str(THREADS), *map(str, words)]
        return json.loads(subprocess.run(line, check=True, stdout=subprocess.PIPE).stdout)

    def once(name, make):
        """What an earlier, interrupted run has found, or finds it now."""
        path = args.output / f"{name}.json"
        if not path.exists():
            path.write_text(json.dumps(make()) + "\n")
        return json.loads(path.read_text())

    def ours(steps, output):
        rates = ("--loss", "bce-mse", "--learning-rate", RATES["layers"], "--filter-learning-rate", RATES["filters"])
        start = ("--from", at("start.checkpoint"), "--instrument", instrument)
        return program("train", pairs, *start, *rates, "--steps", steps, "-o", output)

    # Sizes of the network: those of preset `nano` for these frames and objects.
    plan = json.loads((pairs / "dataset.json").read_text())
    side = 1 << (max(*plan["frame"], *plan["object"]) - 1).bit_length()
    shape = {"channels": 6, "width": 16, "groups": 2, "blocks": 1, "reduction": 8, "filter_size": side}
    network = Network({**shape, "frame": plan["frame"], "object": plan["object"]})
    if Path(at("start.pth")).exists():
        network.load_state_dict(torch.load(at("start.pth")))
    torch.save(network.state_dict(), at("start.pth"))
    program("import-pth", at("start.pth"), "--instrument", instrument, "-o", at("start.checkpoint"))

    mine = once("ommatidia", lambda: ours(args.steps, at("ommatidia.checkpoint")))
    data = Data(pairs, at("ommatidia.checkpoint"))
    with torch.no_grad():
        print("held-out loss of the common start:", statistics.mean(loss_of(network(x), t).item() for x, t in data.held))

    def theirs():
        curve, best = train(network, data, args.steps)
        torch.save(best, at("pytorch.pth"))
        return curve

    curve = once("pytorch", theirs)
    program("import-pth", at("pytorch.pth"), "--instrument", instrument, "-o", at("pytorch.checkpoint"))
    both = [word for name in ("ommatidia", "pytorch") for word in ("--with", at(f"{name}.checkpoint"))]
    judged = program("evaluate", args.demo / "session", *both)["methods"]

    # The race. PyTorch's pairs are drawn before: what its step takes is the network alone; ours draws within the step.
    taken = {"ommatidia": [], "pytorch": [], "pytorch, channels last": []}
    ready = [data.draw() for _ in range(args.race)]
    for _ in range(args.rounds):
        taken["ommatidia"].append(ours(args.race, at("race.checkpoint"))["step_seconds"])
        for name, layout in (("pytorch", torch.contiguous_format), ("pytorch, channels last", torch.channels_last)):
            network.load_state_dict(torch.load(at("start.pth")))
            run, steps = Training(network.to(memory_format=layout), args.race), []
            for frame, target in ready:
                begin = time.perf_counter()
                run.step(frame, target)
                steps.append(time.perf_counter() - begin)
            taken[name].append(statistics.median(steps))
    race = {name: statistics.median(seconds) for name, seconds in taken.items()}

    curves = {"ommatidia": mine["curve"], "PyTorch": curve}
    svg(args.output / "curves.svg", curves)
    found = {name: next(m for key, m in judged.items() if name in key) for name in ("ommatidia", "pytorch")}
    result = {"steps": args.steps, "curves": curves, "judged": found, "step_seconds": race, "rounds": taken}
    (args.output / "result.json").write_text(json.dumps(result, indent=1) + "\n")
    rows = ["| | PSNR, dB | SSIM | NRMSE | held-out loss | ms a step | ratio |", "|---|---|---|---|---|---|---|"]
    for name, seconds in race.items():
        m = found.get(name)
        held = min(p["validation_loss"] for p in curves["PyTorch" if name == "pytorch" else name]) if m else None
        figures = f"{m['psnr_db']:.2f} | {m['ssim']:.3f} | {m['nrmse']:.3f} | {held:.4f}" if m else "| | |"
        rows.append(f"| {name} | {figures} | {1e3 * seconds:.1f} | {seconds / race['ommatidia']:.2f} |")
    (args.output / "table.md").write_text("\n".join(rows) + "\n")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
