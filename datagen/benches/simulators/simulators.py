"""Compares the rendering speed of flowservo with PyBullet and MuJoCo on this machine. `datagen/benches/simulators.sh` runs it
in its own environment.

flowservo generates a dataset. Both simulators then build the scenes of its rows and render them from the same cameras. All
sides take turns, pinned to the same cores: one, then two (two processes of a simulator, with one core each). The timing of a
simulator starts at the render call. It ends with an array of bytes for "images", with a PNG by Pillow for "PNG" (the faster
of its fastest and its default level), and with a Parquet file on disk for "dataset". For flowservo, "dataset" is the whole
program, which also draws the scenes, solves the inverse kinematics and checks contacts. The simulators get these for free.
`renderers.py` lists further conditions that favor them.

The images of all sides are compared before anything is measured.
"""

import argparse
import io
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from renderers import PNG_LEVELS, RENDERERS
from scenes import views_of

HERE = Path(__file__).parent
REPOSITORY = HERE.parent.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", REPOSITORY / "target"))
FLOWSERVO = "flowservo"
STAGES = ["images", "PNG", "dataset"]
GOAL, MINIMUM = 20, 12

# Two images show the same view if this fraction of their pixels shows the same kind of surface.
ALIKE = 0.99


class Worker:
    """A process on given cores that answers commands, one per line."""

    def __init__(self, command, cores, log):
        self.log = log
        environment = dict(os.environ, LP_NUM_THREADS="0", RAYON_NUM_THREADS=str(len(cores)))
        command = ["taskset", "--cpu-list", ",".join(map(str, cores)), *map(str, command)]
        pipe = subprocess.PIPE
        with open(log, "w") as errors:
            self.process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, stderr=errors, text=True)

    def ask(self, line):
        print(line, file=self.process.stdin, flush=True)

    def answer(self):
        line = self.process.stdout.readline()
        if not line:
            command = " ".join(self.process.args)
            hint = "the Debian packages libegl1 and libgl1-mesa-dri provide EGL on the CPU"
            sys.exit(f"{self.log.read_text()[-2000:]}\n{command}\nexited with code {self.process.wait()}; {hint}")
        return json.loads(line)

    def close(self):
        self.process.stdin.close()
        self.process.wait()


class Simulator:
    """One simulator, with one process per core."""

    def __init__(self, name, folder, cores, options):
        self.name = name
        extra = [options.multisamples] if name.startswith("MuJoCo") else []
        command = lambda part: [sys.executable, HERE / "renderers.py", name, folder, part, len(cores), *extra]
        log = lambda part: folder.parent / f"{name}-{part}.log"
        self.workers = [Worker(command(part), [core], log(part)) for part, core in enumerate(cores)]

    def images(self, count):
        self.workers[0].ask(f"images {count}")
        self.workers[0].answer()

    def measure(self):
        """Returns the seconds until each stage is reached, and the PNG level."""
        for worker in self.workers:
            worker.ask("measure")
        found = [worker.answer() for worker in self.workers]
        level = min(PNG_LEVELS, key=lambda level: sum(part[f"png{level}"] for part in found))
        slowest = lambda *stages: max(sum(part[stage] for stage in stages) for part in found)
        stages = ["render", f"png{level}", "store"]
        return {stage: slowest(*stages[: i + 1]) for i, stage in enumerate(STAGES)} | dict(level=level)

    def close(self):
        for worker in self.workers:
            worker.close()


class Flowservo:
    """flowservo: the program for whole datasets, and a benchmark that only renders."""

    name = FLOWSERVO

    def __init__(self, bench, program, folder, cores, options):
        self.repeat, self.out = options.repeat, folder.parent / "again"
        self.generate = ["taskset", "--cpu-list", ",".join(map(str, cores))]
        self.generate += [*program.command(options.rows * self.repeat), "--threads", len(cores), "--out", self.out]
        self.worker = Worker([bench, folder / "config.toml"], cores, folder.parent / "flowservo.log")

    def measure(self):
        """Measures several repetitions, and a dataset with that many times the rows, because a single one is too short."""
        found = []
        for _ in range(self.repeat):
            self.worker.ask("measure")
            found.append(self.worker.answer())
        seconds = {stage: statistics.fmean(one[stage] for one in found) for stage in ("images", "PNG")}
        start = time.perf_counter()
        run(self.generate)
        seconds["dataset"] = (time.perf_counter() - start) / self.repeat
        shutil.rmtree(self.out)
        return seconds

    def close(self):
        self.worker.close()


class Program:
    """The flowservo program that generates the dataset."""

    def __init__(self, options):
        self.path, self.config = options.flowservo, options.config

    def command(self, rows):
        return [self.path, "dataset", "generate", self.config, "--set", f"count={rows}"]


def run(command):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)


def build():
    """Compiles the benchmark of flowservo and returns its path."""
    command = "cargo bench --package datagen --bench simulators --no-run --message-format=json-render-diagnostics".split()
    built = subprocess.run(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    if built.returncode != 0:
        sys.exit(built.returncode)
    artifacts = (json.loads(line) for line in built.stdout.splitlines())
    return next(a["executable"] for a in artifacts if a.get("target", {}).get("name") == "simulators" and a["executable"])


def things(image):
    """Classifies pixels by saturation, independently of the light: 0 table, 1 white or gray bodies, 2 cross."""
    pixels = np.asarray(image.convert("RGB")).astype(float)
    most = pixels.max(axis=2)
    saturation = (most - pixels.min(axis=2)) / np.maximum(most, 1)
    return np.select([saturation < 0.2, saturation > 0.65], [1, 2])


def compare(name, folder, views):
    """Exits unless the images of a simulator match those of the dataset."""
    alike = []
    for number, view in enumerate(views):
        ours, theirs = Image.open(io.BytesIO(view.png)), Image.open(folder / f"{name}-{number}.png")
        alike.append(np.mean(things(ours) == things(theirs)))
    share = f"{100 * np.mean(alike):.2f} % of the pixels, {100 * min(alike):.2f} % in the worst of {len(views)} images"
    print(f"{name:<14} matches flowservo in {share}")
    if min(alike) < ALIKE:
        sys.exit(f"{name} renders a different view: at least {100 * ALIKE:g} % of the pixels must match; use --picture to see it")


def picture(path, names, folder, views):
    """Saves the current images of up to three rows, side by side."""
    (width, height), rows = views[0].size, min(3, len(views) // 2)
    sheet = Image.new("RGB", (width * (1 + len(names)), height * rows))
    for row, number in enumerate(range(0, 2 * rows, 2)):
        images = [Image.open(io.BytesIO(views[number].png)), *(Image.open(folder / f"{name}-{number}.png") for name in names)]
        for column, (name, image) in enumerate(zip([FLOWSERVO, *names], images)):
            sheet.paste(image, (column * width, row * height))
            ImageDraw.Draw(sheet).text((column * width + 10, row * height + 10), name, font_size=28)
    sheet.save(path)


def quartiles(values):
    return statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3


def measure(sides, rounds):
    """Returns the measurements of each side in each round."""
    found = {side.name: [] for side in sides}
    for number in range(rounds):
        # The order alternates, so that no side is always first.
        for side in sides if number % 2 == 0 else sides[::-1]:
            found[side.name].append(side.measure())
    return found


def report(found, frames):
    """Prints frames per second and ratios, and returns the ratios."""
    print(f"{'':<16}" + "".join(f"{stage:>26}" for stage in STAGES))
    for name, rounds in found.items():
        cells = []
        for stage in STAGES:
            first, median, third = quartiles([frames / one[stage] for one in rounds])
            cells.append(f"{median:.1f} ({first:.1f}-{third:.1f})")
        level = f"   PNG level {rounds[0]['level']}" if "level" in rounds[0] else ""
        print(f"{name:<16}" + "".join(f"{cell:>26}" for cell in cells) + level)
    ratios, cells = {}, []
    for stage in STAGES:
        theirs = {name: statistics.median(one[stage] for one in rounds) for name, rounds in found.items() if name != FLOWSERVO}
        best = min(theirs, key=theirs.get)
        each = [theirs[stage] / ours[stage] for ours, theirs in zip(found[FLOWSERVO], found[best])]
        ratios[stage] = first, median, third = quartiles(each)
        cells.append(f"{median:.1f} ({first:.1f}-{third:.1f})")
    print(f"{'ratio to best':<16}" + "".join(f"{cell:>26}" for cell in cells), flush=True)
    return ratios


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=128, help="rows of the dataset, with two images each (128)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds per side (5)")
    parser.add_argument("--repeat", type=int, default=10, help="repetitions by flowservo per round (10)")
    parser.add_argument("--cores", type=int, nargs="+", default=[1, 2], metavar="N", help="numbers of cores to compare on (1 2)")
    parser.add_argument("--simulators", nargs="+", default=list(RENDERERS), choices=list(RENDERERS), help="simulators to compare with (all)")
    parser.add_argument("--multisamples", type=int, default=4, help="samples per pixel in MuJoCo (4, its default; 0 is fastest)")
    parser.add_argument("--config", default=REPOSITORY / "configs/datasets/c.toml", help="configuration of the dataset (configs/datasets/c.toml)")
    program = TARGET / "release/flowservo"
    parser.add_argument("--flowservo", type=Path, default=program, help="release build of flowservo (target/release/flowservo)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="write three images of each side to this file")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all measurements to this file")
    options = parser.parse_args()
    if not options.flowservo.exists():
        parser.error(f"{options.flowservo} does not exist; run cargo build --release")
    if shutil.which("taskset") is None:
        parser.error("taskset is missing (Debian: util-linux)")
    available = sorted(os.sched_getaffinity(0))
    if max(options.cores) > len(available):
        parser.error(f"--cores {max(options.cores)}: only {len(available)} cores are available")
    return options, available


def main():
    options, available = arguments()
    load = os.getloadavg()[0]
    bench = build()
    program = Program(options)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder) / "dataset"
        run([*program.command(options.rows), "--out", folder])
        views = views_of(folder)
        shown = min(len(views), 64)
        for name in options.simulators:
            side = Simulator(name, folder, available[:1], options)
            side.images(shown)
            side.close()
        if options.picture:
            picture(options.picture, options.simulators, folder, views)
        for name in options.simulators:
            compare(name, folder, views[:shown])
        width, height = views[0].size
        print(f"{options.rows} rows, {len(views)} images of {width} x {height}, {options.rounds} rounds; frames per second")
        if load > 0.5:
            print(f"WARNING: the machine is busy (load {load:.1f}); the ratios are unreliable")
        results = []
        for count in options.cores:
            cores = available[:count]
            sides = [Flowservo(bench, program, folder, cores, options)]
            sides += [Simulator(name, folder, cores, options) for name in options.simulators]
            found = measure(sides, options.rounds)
            for side in sides:
                side.close()
            print(f"\n{count} core{'s' * (count > 1)}")
            ratios = report(found, len(views))
            results.append(dict(cores=count, frames=len(views), seconds=found, ratios=ratios))
        print(f"\ngoal: {GOAL} times the better simulator in 'dataset', and at least {MINIMUM} times")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
