"""Uses a published model in PyTorch, without flowservo: python load_in_pytorch.py MODEL CURRENT.png [GOAL.png]

MODEL is a folder written by `flowservo model pull` or `flowservo model export --format huggingface`. Its config.json describes
the network completely. Prints the same output as `flowservo model predict`: six numbers in meters and radians for CNN_approach,
180 numbers from 0 to 1 for CNN_avoid. The size of the images is the input size of the network or a multiple of it.
Needs torch, safetensors, numpy and pillow.
"""

import json
import sys
from pathlib import Path

import numpy
import torch
from PIL import Image
from safetensors.torch import load_file
from torch.nn import functional as F


def load(folder):
    folder = Path(folder)
    config = json.loads((folder / "config.json").read_text())
    weights = next(folder / name for name in ("weights.safetensors", "model.safetensors") if (folder / name).exists())
    return config, load_file(weights)


def image(path, spec):
    """Pixels as `[1, 3, height, width]`: averaged over equal areas, rounded to bytes (halves up), then scaled."""
    pixels = torch.from_numpy(numpy.array(Image.open(path).convert("RGB"))).permute(2, 0, 1)[None].double()
    factor = pixels.shape[3] // spec["width"]
    assert pixels.shape[2:] == (factor * spec["height"], factor * spec["width"]), f"{path}: {pixels.shape}"
    return ((F.avg_pool2d(pixels, factor) + 0.5).floor() * spec["scale"] + spec["offset"]).float()


def correlation(first, second, reach, stride):
    height, width = first.shape[2:]
    padded, steps = F.pad(second, (reach,) * 4), range(0, 2 * reach + 1, stride)
    shifted = (padded[:, :, y : y + height, x : x + width] for y in steps for x in steps)
    return torch.stack([(first * part).mean(1) for part in shifted], 1)


def network(config, weights, images):
    """Output of the network for the images in this order."""
    net = config["network"]
    active = lambda x: F.leaky_relu(x, net["activation"]["slope"])

    def convolve(x, layer):
        weight = weights[layer["name"] + ".weight"].permute(3, 2, 0, 1)  # from [k, k, in, out]
        return active(F.conv2d(x, weight, weights[layer["name"] + ".bias"], layer["stride"], layer["padding"]))

    for layer in net["each_image"]:
        images = [convolve(x, layer) for x in images]
    kind = net["combine"]["kind"]
    if kind == "difference":
        x = images[1] - images[0]
    elif kind == "correlation":
        agreement = active(correlation(*images, net["combine"]["reach"], net["combine"]["stride"]))
        x = torch.cat([convolve(images[0], net["combine"]["redirect"]), agreement], 1)
    else:  # "stack" of two images, "none" of one
        x = torch.cat(images, 1)
    for layer in net["combined"]:
        x = convolve(x, layer)
    x = x.mean((2, 3)) if net["flatten"] == "mean_of_channels" else x.permute(0, 2, 3, 1).flatten(1)
    for index, layer in enumerate(net["head"]):
        x = (active(x) if index > 0 else x) @ weights[layer["name"] + ".weight"] + weights[layer["name"] + ".bias"]
    return x


def predict(folder, paths):
    config, weights = load(folder)
    images = [image(path, config["input"]) for path in paths]
    assert len(images) == len(config["input"]["images"]), f"expected images: {config['input']['images']}"
    x = network(config, weights, images)
    if config["network"]["symmetry"] == "antisymmetric":
        x = (x - network(config, weights, images[::-1])) / 2
    x, output = x[0].double(), config["output"]
    if output["kind"] == "avoidance_map":
        return x.clamp(*output["clamp"])
    return x * torch.tensor(output["scale"], dtype=x.dtype) + torch.tensor(output["mean"], dtype=x.dtype)


if __name__ == "__main__":
    print(json.dumps(predict(sys.argv[1], sys.argv[2:]).tolist()))
