"""Writes tiny.pth and tiny.json: a small network as PyTorch keeps it, a frame, and what PyTorch makes of it.

    python tiny.py        # PyTorch 2; written with 2.15

Names, order of operations and the crop (from h/2 + 1 - side/2) are those of the published network; the modules are written anew.
"""

import json
from collections import OrderedDict

import torch
import torch.nn.functional as f

torch.manual_seed(1)
T, C, W, GROUPS, BLOCKS, BOTTLENECK, SIDE, FRAME = 16, 2, 4, 2, 1, 2, 8, (12, 10)

state = OrderedDict()
state["deconvolution.psfs_re"] = torch.rand(C, T, T // 2 + 1) * 0.001
state["deconvolution.psfs_im"] = torch.rand(C, T, T // 2 + 1) * 0.001


def layer(name, outputs, inputs, side):
    state[name + ".weight"] = torch.randn(outputs, inputs, side, side) * (1.0 / (inputs * side * side)) ** 0.5
    state[name + ".bias"] = torch.randn(outputs) * 0.1


# The published module holds these two and never uses them.
layer("deconvolution.conv", C, C, 3)
state["deconvolution.activation.weight"] = torch.full((1,), 0.25)
layer("enhancement.downscale.1", W, 4 * C, 3)
for g in range(GROUPS):
    for b in range(BLOCKS):
        at = f"enhancement.rgs.{g}.module.{b}.module"
        layer(f"{at}.0", W, W, 3)
        layer(f"{at}.2", W, W, 3)
        layer(f"{at}.3.module.1", BOTTLENECK, W, 1)
        layer(f"{at}.3.module.3", W, BOTTLENECK, 1)
    layer(f"enhancement.rgs.{g}.module.{BLOCKS}", W, W, 3)
layer("enhancement.conv1", W, W, 3)
layer("enhancement.upscale.0", 4 * W, W, 3)
layer("enhancement.conv2", 1, W, 3)


def conv(name, x):
    weight = state[name + ".weight"]
    return f.conv2d(x, weight, state[name + ".bias"], padding=weight.shape[-1] // 2)


def network(frame):
    rows, cols = ((T - n) // 2 for n in FRAME)
    padded = f.pad(frame, (cols, cols, rows, rows))
    filters = torch.complex(state["deconvolution.psfs_re"], state["deconvolution.psfs_im"])
    x = torch.fft.irfft2(torch.fft.rfft2(padded)[None] * filters, s=(T, T))
    start = T // 2 + 1 - SIDE // 2
    x = (x / x.max())[:, start : start + SIDE, start : start + SIDE]
    x = (x / x.max())[None]
    head = conv("enhancement.downscale.1", f.pixel_unshuffle(x, 2))
    y = head
    for g in range(GROUPS):
        inner = y
        for b in range(BLOCKS):
            at = f"enhancement.rgs.{g}.module.{b}.module"
            r = conv(f"{at}.2", f.relu(conv(f"{at}.0", inner)))
            gate = f.relu(conv(f"{at}.3.module.1", r.mean((2, 3), keepdim=True)))
            inner = inner + r * torch.sigmoid(conv(f"{at}.3.module.3", gate))
        y = y + conv(f"enhancement.rgs.{g}.module.{BLOCKS}", inner)
    y = f.pixel_shuffle(conv("enhancement.upscale.0", conv("enhancement.conv1", y) + head), 2)
    return torch.sigmoid(conv("enhancement.conv2", y))[0, 0]


frame = torch.rand(FRAME)
torch.save(state, "tiny.pth")
with open("tiny.json", "w") as out:
    found = network(frame / frame.max())
    json.dump({"frame": frame.flatten().tolist(), "object": found.flatten().tolist()}, out)
    out.write("\n")
