"""Compares flowservo's networks with PyTorch on this machine. Run it with `train/benches/pytorch.sh`.

Speed: the two sides alternate in short bursts, one idle while the other runs, so that disturbances affect both. The ratio
of a round is flowservo to PyTorch in examples per second; above 1, flowservo is faster.

Numbers (`--check`): both sides compute the output, the gradients and a few steps from the same weights and inputs.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch.nn import functional as F

from networks import ApproachNet

# As in configs/train/ and in pytorch.rs.
LEARNING_RATE, WEIGHT_DECAY, GRADIENT_CLIP = 1e-3, 0.01, 1.0

# Permutation of flowservo's convolution weights, [k, k, in, out], to those of PyTorch, [out, in, k, k].
CONV_AXES = (3, 2, 0, 1)

CASE_FORM = "train|infer/TRUNK/SYMMETRY/WIDTH/INPUT/BATCH, e.g. train/flownet_s/antisymmetric/0.25/128x96/32"
NETWORKS = ["flownet_s/none", "flownet_s/antisymmetric", "definet/none"]
CASES = (
    [f"train/{network}/0.25/128x96/{batch}" for batch in (32, 64) for network in NETWORKS]
    + [f"train/{network}/1.0/128x96/8" for network in NETWORKS]
    + ["infer/flownet_s/antisymmetric/0.25/128x96/1"]
)
TRUNKS = ["flownet_s", "flownet_c", "definet", "definet_gap"]
SYMMETRIES = ["none", "antisymmetric"]
CHECKS = [f"train/{t}/{s}/0.25/{size}" for t in TRUNKS for s in SYMMETRIES for size in ("128x96/4", "100x75/3")]

CHECKED_STEPS = 3
LAST_LOSS = "loss of the third step"
SETTLE_S = 0.03  # Lets the threads of the other side stop spinning.


@dataclass
class Case:
    """A measurement or a check."""

    verb: str
    batch: int
    network: dict

    @classmethod
    def parse(cls, text, head):
        try:
            verb, trunk, symmetry, width, size, batch = text.split("/")
            size = [int(pixels) for pixels in size.split("x")]
        except ValueError:
            sys.exit(f"{text}: expected {CASE_FORM}")
        network = dict(trunk=trunk, symmetry=symmetry, width=float(width), input=size, head=head)
        return cls(verb, int(batch), network)


class Ours:
    """The flowservo half, in its own process."""

    name = "flowservo"

    def __init__(self, program, threads, device):
        environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([program], stdin=pipe, stdout=pipe, env=environment, text=True)
        self.device = device

    def ask(self, **command):
        print(json.dumps(command), file=self.process.stdin, flush=True)
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"the flowservo half exited with code {self.process.wait()} on {command}")
        answer = json.loads(line)
        if "error" in answer:
            sys.exit(f"the flowservo half failed on {command}: {answer['error']}")
        return answer

    def setup(self, case):
        self.ask(setup=dict(device=self.device, batch=case.batch, network=case.network))

    def burst(self, verb, times):
        return self.ask(**{verb: times})["seconds"]


class Theirs:
    """The PyTorch half with its fastest settings in f32: channels last, fused AdamW, in-place rectifiers."""

    def __init__(self, device, dtype=None):
        self.device, self.dtype = torch.device(device), dtype
        self.name = "PyTorch" if dtype is None else "PyTorch bf16"

    def setup(self, case):
        torch.manual_seed(1)
        width, height = case.network["input"]
        self.take(ApproachNet(**case.network), *torch.rand(2, case.batch, 3, height, width), torch.rand(case.batch, 6))

    def take(self, network, current, goal, target):
        """Uses the float type of the inputs."""
        place = dict(device=self.device, memory_format=torch.channels_last)
        self.network = network.to(dtype=current.dtype, **place)
        self.images = current.to(**place), goal.to(**place)
        self.target = target.to(self.device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=LEARNING_RATE, eps=1e-8, weight_decay=WEIGHT_DECAY, fused=True
        )

    def output(self):
        with torch.autocast(self.device.type, self.dtype, enabled=self.dtype is not None):
            return self.network(*self.images)

    def gradients(self):
        self.optimizer.zero_grad(set_to_none=True)
        output = self.output()
        loss = F.mse_loss(output.to(self.target.dtype), self.target)
        loss.backward()
        return output.detach(), loss.detach()

    def train(self, steps):
        for _ in range(steps):
            _, loss = self.gradients()
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), GRADIENT_CLIP, foreach=True)
            self.optimizer.step()
        return loss

    def infer(self, outputs):
        with torch.inference_mode():
            for _ in range(outputs):
                self.output().cpu()

    def burst(self, verb, times):
        start = time.perf_counter()
        getattr(self, verb)(times)
        if self.device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - start


def measure(case, sides, rounds, burst):
    """Returns seconds per step (or output) of each burst, by side."""
    for side in sides:
        side.setup(case)
        side.burst(case.verb, 3)
    times = max(1, round(burst / max(side.burst(case.verb, 3) / 3 for side in sides)))
    seconds = {side.name: [] for side in sides}
    for number in range(rounds):
        # Alternate the order, so that no side always goes first.
        for side in sides if number % 2 == 0 else sides[::-1]:
            time.sleep(SETTLE_S)
            seconds[side.name].append(side.burst(case.verb, times) / times)
    return seconds


def ratios(seconds, ours, theirs):
    """Returns first quartile, median and third quartile of the ratios of the rounds."""
    found = [b / a for a, b in zip(seconds[ours], seconds[theirs])]
    return statistics.quantiles(found, n=4, method="inclusive") if len(found) > 1 else found * 3


def compare(options, ours):
    threads = f"{options.threads} threads" if options.device == "cpu" else torch.cuda.get_device_name()
    print(f"PyTorch {torch.__version__}, {options.device}, {threads}, {options.rounds} rounds; examples per second")
    if os.getloadavg()[0] > 0.5:
        # PyTorch synchronizes its threads at every operation and suffers more from other load.
        print(f"WARNING: the machine is busy (load {os.getloadavg()[0]:.1f}); these ratios are meaningless")
    theirs = [Theirs(options.partner)] + [Theirs(options.partner, torch.bfloat16)] * options.bf16
    sides = [ours, *theirs]
    columns = "".join(f"{side.name:>14}" for side in sides)
    print(f"\n{'case':<46}{columns}   ratio (quartiles)")
    results = []
    for text in options.cases or CASES:
        case = Case.parse(text, options.head)
        seconds = measure(case, sides, options.rounds, options.burst)
        rates = "".join(f"{case.batch / statistics.median(seconds[side.name]):>14.1f}" for side in sides)
        first, median, third = ratios(seconds, ours.name, "PyTorch")
        print(f"{text:<46}{rates}   {median:.2f} ({first:.2f}-{third:.2f})", flush=True)
        results.append(dict(case=text, **asdict(case), seconds=seconds, ratio=[first, median, third]))
    return results


def weights_of(file):
    """Reads flowservo's weights in PyTorch's layout."""
    tensors = load_file(file)
    axes = {4: CONV_AXES, 2: (1, 0), 1: (0,)}
    return {name: tensor.permute(axes[tensor.ndim]) for name, tensor in tensors.items()}


def computed_by_theirs(case, weights, sample, steps, dtype):
    """Returns output, loss, gradients and the loss of the last step, computed in one float type on the CPU."""
    network, theirs = ApproachNet(**case.network), Theirs("cpu")
    network.load_state_dict(weights)
    current, goal = (sample[key].to(dtype).permute(0, 3, 1, 2) for key in ("current", "goal"))
    theirs.take(network, current, goal, sample["target"].to(dtype))
    output, loss = theirs.gradients()
    gradients = {name: weight.grad.clone() for name, weight in network.named_parameters()}
    return output, loss, gradients, theirs.train(steps)


def computed_by_ours(case, ours, steps):
    """Returns the weights, the sample, and the same values as `computed_by_theirs`."""
    with tempfile.TemporaryDirectory() as folder:
        ours.setup(case)
        loss = torch.tensor(ours.ask(export=folder)["loss"])
        sample = load_file(f"{folder}/sample.safetensors")
        weights, gradients = (weights_of(f"{folder}/{name}.safetensors") for name in ("weights", "gradients"))
    return weights, sample, (sample["output"], loss, gradients, torch.tensor(ours.ask(train=steps)["loss"]))


def differences(found, oracle):
    """Returns the maximum deviation of each tensor relative to its maximum value. Losses are relative to the first loss.
    Gradients, some of which are zero, are relative to at least a hundredth of the maximum gradient."""
    far = lambda a, b: (a.double() - b).abs().max().item()
    output, loss, gradients, last = oracle
    least = 1e-2 * max(gradient.abs().max().item() for gradient in gradients.values())
    result = {"output": far(found[0], output) / output.abs().max().item()}
    result |= {"loss": far(found[1], loss) / loss.item(), LAST_LOSS: far(found[3], last) / loss.item()}
    for name, gradient in gradients.items():
        result[f"gradient of {name}"] = far(found[2][name], gradient) / max(gradient.abs().max().item(), least)
    return result


def check_case(case, ours, tolerance):
    """Prints the differences and returns how many exceed the tolerance."""
    weights, sample, mine = computed_by_ours(case, ours, CHECKED_STEPS)
    oracle, single = (
        computed_by_theirs(case, weights, sample, CHECKED_STEPS, dtype) for dtype in (torch.float64, torch.float32)
    )
    # Within rounding of a rectifier's kink, single precision may end on the other side. That is accepted if PyTorch in
    # single precision does the same.
    double, twin = differences(mine, oracle), differences(mine, single)
    single = differences(single, oracle)
    found = {name: min(double[name], twin[name]) for name in double}
    # AdamW's first steps follow the sign of the gradient, which rounding decides where the gradient is small.
    limit = dict.fromkeys(found, tolerance) | {LAST_LOSS: 100 * tolerance}
    for name in found:
        verdict = "" if found[name] <= limit[name] else "   TOO LARGE"
        print(f"  {name:<44} {double[name]:9.1e} {single[name]:12.1e} {twin[name]:12.1e}{verdict}")
    return sum(not found[name] <= limit[name] for name in found)


def check(options, ours):
    print("Relative differences of flowservo and of PyTorch f32 from PyTorch f64, and of the first two from each other.")
    print(f"flowservo passes if it is within {options.tolerance:g} of either ({LAST_LOSS}: {100 * options.tolerance:g}).")
    failed = 0
    for text in options.cases or CHECKS:
        print(f"\n{text:<46} flowservo  PyTorch f32   each other")
        failed += check_case(Case.parse(text, options.head), ours, options.tolerance)
    print(f"\n{failed} differences are too large" if failed else "\nall agree")
    return failed


def build(device):
    """Compiles the flowservo half and returns the path of the program."""
    command = "cargo bench -p train --bench pytorch --no-run --message-format=json-render-diagnostics".split()
    command += [] if device == "cpu" else ["--features", device]
    built = subprocess.run(command, cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True)
    if built.returncode != 0:
        sys.exit(built.returncode)
    artifacts = (json.loads(line) for line in built.stdout.splitlines())
    return next(a["executable"] for a in artifacts if a.get("target", {}).get("name") == "pytorch")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", metavar="CASE", help=CASE_FORM)
    parser.add_argument("--head", type=int, default=512, help="units of the hidden layers (512)")
    parser.add_argument("--rounds", type=int, default=15, help="bursts per side (15)")
    parser.add_argument("--burst", type=float, default=1.0, help="duration of a burst of the slower side in seconds (1)")
    parser.add_argument("--quick", action="store_true", help="5 rounds of 0.3 s")
    parser.add_argument("--bf16", action="store_true", help="also measure PyTorch with bfloat16 autocast")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    parser.add_argument("--threads", type=int, default=cores, help=f"threads per side ({cores})")
    parser.add_argument("--device", choices=["cpu", "wgpu", "cuda"], default="cpu", help="device of flowservo; PyTorch uses cpu or cuda")
    parser.add_argument("--check", action="store_true", help="compare the numbers instead of the speed")
    parser.add_argument("--tolerance", type=float, default=1e-4, help="tolerance of --check (1e-4)")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write all bursts to FILE")
    options = parser.parse_args()
    if options.quick:
        options.rounds, options.burst = 5, 0.3
    options.partner = "cpu" if options.device == "cpu" else "cuda"
    return options


def main():
    options = arguments()
    if options.partner == "cuda" and not (options.check or torch.cuda.is_available()):
        sys.exit(f"--device {options.device} is compared with PyTorch on CUDA, which is not available here")
    torch.set_num_threads(options.threads)
    torch.backends.cudnn.benchmark = True
    ours = Ours(build(options.device), options.threads, options.device)
    if options.check:
        return 1 if check(options, ours) else 0
    load = os.getloadavg()[0]
    results = compare(options, ours)
    if options.json:
        about = dict(machine=platform.platform(), torch=torch.__version__, device=options.device)
        about |= dict(threads=options.threads, load=load, cases=results)
        options.json.write_text(json.dumps(about, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
