"""Speed of making images against PyBullet and MuJoCo on this machine: `datagen/benches/simulators.sh` runs it in its own
environment.

flowservo makes a dataset; both simulators then build the scenes that stand in its rows and render them from the cameras that
stand in its rows. All sides take turns, each pinned to the same cores: one, then two (two processes of a simulator, each with
a core). A frame of the simulators counts from the call that renders it; in "images" it ends as an array of bytes, in "PNG" as
a PNG by Pillow (the faster of its fastest and its default level), in "dataset" as a Parquet file on disk. In "dataset" ours
is the whole program from start to end, which also draws the scenes, solves the arm's joints and checks contacts: the
simulators get those for nothing. `renderers.py` says what else is generous to them.

Before anything is measured, the images of all sides are compared.
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
OURS = "flowservo"
STAGES = ["images", "PNG", "dataset"]
AIM, LEAST = 20, 12

# Two images show the same view if this share of the pixels shows the same thing.
ALIKE = 0.99


class Worker:
    """A process that answers lines, on given cores."""

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
            hint = "EGL that renders on the CPU is in Debian's libegl1 and libgl1-mesa-dri"
            sys.exit(f"{self.log.read_text()[-2000:]}\n{command}\nended with code {self.process.wait()}; {hint}")
        return json.loads(line)

    def close(self):
        self.process.stdin.close()
        self.process.wait()


class Simulator:
    """One simulator, a process a core."""

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
        """Seconds until each stage is reached, and the PNG level."""
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


class Ours:
    """flowservo: the program for whole datasets, and a part of it that renders only."""

    name = OURS

    def __init__(self, bench, program, folder, cores, options):
        self.repeat, self.out = options.repeat, folder.parent / "again"
        self.generate = ["taskset", "--cpu-list", ",".join(map(str, cores))]
        self.generate += [*program.command(options.rows * self.repeat), "--threads", len(cores), "--out", self.out]
        self.worker = Worker([bench, folder / "config.toml"], cores, folder.parent / "flowservo.log")

    def measure(self):
        """Many times over, and a dataset of as many times the rows: it is soon done."""
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
    """The flowservo that makes the dataset."""

    def __init__(self, options):
        self.path, self.config = options.flowservo, options.config

    def command(self, rows):
        return [self.path, "dataset", "generate", self.config, "--set", f"count={rows}"]


def run(command):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)


def build():
    """Compiles our half; the path of the program."""
    command = "cargo bench --package datagen --bench simulators --no-run --message-format=json-render-diagnostics".split()
    built = subprocess.run(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    if built.returncode != 0:
        sys.exit(built.returncode)
    artifacts = (json.loads(line) for line in built.stdout.splitlines())
    return next(a["executable"] for a in artifacts if a.get("target", {}).get("name") == "simulators" and a["executable"])


def things(image):
    """What each pixel shows, whatever the light: 0 the table, 1 white or gray bodies, 2 the cross, by their saturation."""
    pixels = np.asarray(image.convert("RGB")).astype(float)
    most = pixels.max(axis=2)
    saturation = (most - pixels.min(axis=2)) / np.maximum(most, 1)
    return np.select([saturation < 0.2, saturation > 0.65], [1, 2])


def compare(name, folder, views):
    """Ends the program unless a simulator's images are those of the dataset."""
    alike = []
    for number, view in enumerate(views):
        ours, theirs = Image.open(io.BytesIO(view.png)), Image.open(folder / f"{name}-{number}.png")
        alike.append(np.mean(things(ours) == things(theirs)))
    share = f"{100 * np.mean(alike):.2f} % of the pixels, {100 * min(alike):.2f} % in the worst of {len(views)} images"
    print(f"{name:<14} shows what flowservo shows: {share}")
    if min(alike) < ALIKE:
        sys.exit(f"{name} renders another view: expected {100 * ALIKE:g} % of the pixels alike; --picture shows it")


def picture(path, names, folder, views):
    """The current images of up to three rows, side by side."""
    (width, height), rows = views[0].size, min(3, len(views) // 2)
    sheet = Image.new("RGB", (width * (1 + len(names)), height * rows))
    for row, number in enumerate(range(0, 2 * rows, 2)):
        images = [Image.open(io.BytesIO(views[number].png)), *(Image.open(folder / f"{name}-{number}.png") for name in names)]
        for column, (name, image) in enumerate(zip([OURS, *names], images)):
            sheet.paste(image, (column * width, row * height))
            ImageDraw.Draw(sheet).text((column * width + 10, row * height + 10), name, font_size=28)
    sheet.save(path)


def quartiles(values):
    return statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3


def measure(sides, rounds):
    """What each side said in each round."""
    found = {side.name: [] for side in sides}
    for number in range(rounds):
        # Forward and backward in turn, so that none is always the first.
        for side in sides if number % 2 == 0 else sides[::-1]:
            found[side.name].append(side.measure())
    return found


def report(found, frames):
    """Prints frames a second and ratios; the ratios."""
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
        theirs = {name: statistics.median(one[stage] for one in rounds) for name, rounds in found.items() if name != OURS}
        best = min(theirs, key=theirs.get)
        each = [theirs[stage] / ours[stage] for ours, theirs in zip(found[OURS], found[best])]
        ratios[stage] = first, median, third = quartiles(each)
        cells.append(f"{median:.1f} ({first:.1f}-{third:.1f})")
    print(f"{'ratio to best':<16}" + "".join(f"{cell:>26}" for cell in cells), flush=True)
    return ratios


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=128, help="of the dataset; each has two images (128)")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each side (5)")
    parser.add_argument("--repeat", type=int, default=10, help="times that ours does the same in a turn (10)")
    parser.add_argument("--cores", type=int, nargs="+", default=[1, 2], metavar="N", help="equal for all sides (1 2)")
    parser.add_argument("--simulators", nargs="+", default=list(RENDERERS), choices=list(RENDERERS), help="all by default")
    parser.add_argument("--multisamples", type=int, default=4, help="samples a pixel of MuJoCo (4, its default; 0 is fastest)")
    parser.add_argument("--config", default=REPOSITORY / "configs/datasets/c.toml", help="dataset (configs/datasets/c.toml)")
    program = TARGET / "release/flowservo"
    parser.add_argument("--flowservo", type=Path, default=program, help="a release build (target/release/flowservo)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="write three images of each side there")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every measurement there")
    options = parser.parse_args()
    if not options.flowservo.exists():
        parser.error(f"{options.flowservo} does not exist: cargo build --release")
    if shutil.which("taskset") is None:
        parser.error("taskset is missing (Debian: util-linux)")
    available = sorted(os.sched_getaffinity(0))
    if max(options.cores) > len(available):
        parser.error(f"--cores {max(options.cores)}, and there are {len(available)}")
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
        print(f"{options.rows} rows, {len(views)} images of {width} x {height}, {options.rounds} rounds; frames a second")
        if load > 0.5:
            print(f"THE MACHINE IS BUSY (load {load:.1f}): these ratios will not mean anything")
        results = []
        for count in options.cores:
            cores = available[:count]
            sides = [Ours(bench, program, folder, cores, options)]
            sides += [Simulator(name, folder, cores, options) for name in options.simulators]
            found = measure(sides, options.rounds)
            for side in sides:
                side.close()
            print(f"\n{count} core{'s' * (count > 1)}")
            ratios = report(found, len(views))
            results.append(dict(cores=count, frames=len(views), seconds=found, ratios=ratios))
        print(f"\naim: {AIM} times the better simulator with PNG in the file, and no less than {LEAST}")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
