"""The networks of `train/src/network/`, written in PyTorch with the same parameter names.

Tensors are `[batch, channels, height, width]`, stored channels-last, which is PyTorch's fast path.
"""

from collections import OrderedDict

import torch
from torch import nn
from torch.nn import functional as F

SLOPE = 0.1

# Output channels at width 1, kernel and stride (Dosovitskiy et al. 2015).
LAYERS = {
    "conv1": (64, 7, 2),
    "conv2": (128, 5, 2),
    "conv3": (256, 5, 2),
    "conv_redir": (32, 1, 1),
    "conv3_1": (256, 3, 1),
    "conv4": (512, 3, 2),
    "conv4_1": (512, 3, 1),
    "conv5": (512, 3, 2),
    "conv5_1": (512, 3, 1),
    "conv6": (1024, 3, 2),
    "conv6_1": (1024, 3, 1),
}
ENCODER = [name for name in LAYERS if name != "conv_redir"]


class LeakyConv(nn.Conv2d):
    """Convolution, bias, leaky rectifier."""

    def __init__(self, inputs, outputs, kernel, stride):
        super().__init__(inputs, outputs, kernel, stride, padding=kernel // 2)

    def forward(self, x):
        return F.leaky_relu(super().forward(x), SLOPE, inplace=True)


class Trunk(nn.Module):
    """Layers with their published names: `encode` sees each image separately, `compare` two encoded images."""

    def __init__(self, width):
        super().__init__()
        self.width = width

    def channels(self, name):
        return max(1, int(LAYERS[name][0] * self.width + 0.5))

    def add(self, names, inputs):
        """Chains layers. The channels of the last one are the number of features."""
        for name in names:
            _, kernel, stride = LAYERS[name]
            self.add_module(name, LeakyConv(inputs, self.channels(name), kernel, stride))
            self.features = inputs = self.channels(name)

    def through(self, names, x):
        for name in names:
            x = getattr(self, name)(x)
        return x


def flat(x):
    """Flattens pixel by pixel, as flowservo does. Returns a view, since memory is channels-last."""
    return x.permute(0, 2, 3, 1).flatten(1)


class FlowNetS(Trunk):
    def __init__(self, width, pixels):
        super().__init__(width)
        self.add(ENCODER, 6)
        self.features *= pixels

    def encode(self, images):
        return images

    def compare(self, first, second):
        return flat(self.through(ENCODER, torch.cat([first, second], 1)))


class FlowNetC(Trunk):
    def __init__(self, width, pixels):
        super().__init__(width)
        self.add(ENCODER[:3], 3)
        self.add(["conv_redir"], self.channels("conv3"))
        self.add(ENCODER[3:], self.channels("conv_redir") + 441)
        self.features *= pixels

    def encode(self, images):
        return self.through(ENCODER[:3], images)

    def compare(self, first, second):
        agreement = F.leaky_relu(correlation(first, second), SLOPE, inplace=True)
        both = torch.cat([self.conv_redir(first), agreement], 1)
        return flat(self.through(ENCODER[3:], both.contiguous(memory_format=torch.channels_last)))


def correlation(a, b, reach=20, stride=2):
    """Computes `mean over c of a[c, y, x] * b[c, y + dy, x + dx]`, zero outside, for displacements in row-major order."""
    height, width = a.shape[2:]
    padded = F.pad(b, (reach,) * 4)
    offsets = range(0, 2 * reach + 1, stride)
    rows = (
        torch.stack([padded[:, :, dy : dy + height, dx : dx + width] for dx in offsets], 1) for dy in offsets
    )
    return torch.cat([(a.unsqueeze(1) * row).mean(2) for row in rows], 1)


class Definet(Trunk):
    """Difference of the features after `conv3_1`, remaining layers, global average pooling."""

    shared = 4

    def __init__(self, width, _pixels):
        super().__init__(width)
        self.add(ENCODER, 3)

    def encode(self, images):
        return self.through(ENCODER[: self.shared], images)

    def compare(self, first, second):
        return self.through(ENCODER[self.shared :], second - first).mean((2, 3))


class DefinetGap(Definet):
    """Difference of the features after all layers, global average pooling."""

    shared = len(ENCODER)


TRUNKS = {"flownet_s": FlowNetS, "flownet_c": FlowNetC, "definet": Definet, "definet_gap": DefinetGap}


class Head(nn.Sequential):
    def __init__(self, inputs, hidden):
        super().__init__(
            OrderedDict(
                hidden1=nn.Linear(inputs, hidden),
                rectified1=nn.LeakyReLU(SLOPE, inplace=True),
                hidden2=nn.Linear(hidden, hidden),
                rectified2=nn.LeakyReLU(SLOPE, inplace=True),
                output=nn.Linear(hidden, 6),
            )
        )


class ApproachNet(nn.Module):
    """`current`, `goal`: `[batch, 3, height, width]`, values from -1 to 1; result: `[batch, 6]`."""

    def __init__(self, trunk, symmetry, width, input, head):
        super().__init__()
        columns, rows = (-(-size // 64) for size in input)
        self.trunk = TRUNKS[trunk](width, rows * columns)
        self.head = Head(self.trunk.features, head)
        self.antisymmetric = symmetry == "antisymmetric"

    def forward(self, current, goal):
        encoded = self.trunk.encode(torch.cat([current, goal]))
        current, goal = encoded.chunk(2)
        if not self.antisymmetric:
            return self.head(self.trunk.compare(current, goal))
        # Both orders of the images in one batch of twice the size.
        swapped = torch.cat([goal, current])
        forward, backward = self.head(self.trunk.compare(encoded, swapped)).chunk(2)
        return (forward - backward) / 2
