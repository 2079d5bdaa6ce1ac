"""A registry in buckets that keep or break their promises, on a server in this process: bucket.py FLOWSERVO."""

import hashlib
import itertools
import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import boto3
from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

FLOWSERVO = sys.argv[1]
ROUNDS = int(os.environ.get("FLOWSERVO_RACES", 3))
PUBLISHERS = 16
# Rounds without a lost race before the test gives up.
MOST_ROUNDS = 50


class Server:
    """moto, one request at a time: it checks for the object and then writes it, so two threads would race."""

    def __init__(self):
        self.moto = DomainDispatcherApplication(create_backend_app)
        self.answered = set()
        self.refused = 0
        # A process to kill after this many requests.
        self.victim, self.requests_left = None, 0
        self.lock = threading.Lock()
        self.server = make_server("127.0.0.1", 0, self.answer, threaded=False)
        self.address = f"http://127.0.0.1:{self.server.port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def answer(self, environ, start_response):
        bucket, _, key = environ["PATH_INFO"].lstrip("/").partition("/")
        conditional = environ["REQUEST_METHOD"] == "PUT" and "HTTP_IF_NONE_MATCH" in environ
        if conditional and bucket == "forgetful":
            del environ["HTTP_IF_NONE_MATCH"]

        if conditional and bucket == "lossy" and "/versions/" in key and key not in self.answered:
            # Done, but the response is lost.
            self.answered.add(key)
            list(self.moto(environ, lambda *_: None))
            start_response("503 Service Unavailable", [("Content-Length", "0")])
            return []

        def count(status, headers, *rest):
            self.refused += bucket == "lab" and "/versions/" in key and status.startswith("412")
            return start_response(status, headers, *rest)

        answer = self.moto(environ, count)
        with self.lock:
            self.requests_left -= 1
            if self.victim and self.requests_left == 0:
                self.victim.kill()
        return answer

    def run_and_kill(self, requests, *arguments):
        """Runs flowservo and kills it when it waits for the answer to this request. False if it makes fewer."""
        with self.lock:
            self.requests_left = requests
            output = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.victim = subprocess.Popen([FLOWSERVO, *arguments], **output)
        killed = self.victim.wait() < 0
        with self.lock:
            self.victim = None
        return killed


def run(*arguments, code=0):
    done = subprocess.run([FLOWSERVO, "model", *arguments], capture_output=True, text=True)
    assert done.returncode == code, f"{arguments}: {done.returncode}, not {code}\n{done.stdout}{done.stderr}"
    return done.stdout if code == 0 else done.stderr


def result(*arguments):
    return json.loads(run(*arguments, "--json").splitlines()[-1])


def checkpoint(name, weights):
    network = {"trunk": "flownet_s", "width": 0.1, "input": [32, 24], "head": 8}
    camera = {"width": 32, "height": 24, "horizontal_fov_deg": 60.0, "behind_hand_mm": 100.0}
    info = {
        "format": 2,
        "task": {"kind": "avoidance", "network": network},
        "standardization": None,
        "camera": camera,
        "datasets": [{"name": "avoid", "digest": "ab" * 32, "rows": 4}],
        "seed": 5,
        "epoch": None,
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
    }
    folder = Path(name)
    folder.mkdir(exist_ok=True)
    (folder / "model.json").write_text(json.dumps(info))
    (folder / "config.toml").write_text("seed = 5\n")
    (folder / "weights.safetensors").write_bytes(weights)
    return name


def safetensors(data):
    """A file with these bytes as its one tensor."""
    header = json.dumps({"w": {"dtype": "U8", "shape": [len(data)], "data_offsets": [0, len(data)]}}).encode()
    return len(header).to_bytes(8, "little") + header + data


def keys(s3, bucket):
    pages = s3.get_paginator("list_objects_v2").paginate(Bucket=bucket)
    return [entry["Key"] for page in pages for entry in page.get("Contents", [])]


def creation(s3):
    assert result("init", "--registry", "s3://lab/models")["created"]
    assert not result("init", "--registry", "s3://lab/models")["created"]
    assert keys(s3, "lab") == ["models/registry.json"], "the probe is deleted"
    refusal = run("init", "--registry", "s3://forgetful/models", code=1)
    assert "s3://forgetful/models" in refusal and "ignores the condition" in refusal, refusal
    refusal = run("publish", checkpoint("run", safetensors(b"x")), "approach", "--registry", "s3://forgetful", code=1)
    assert "ignores the condition" in refusal, refusal
    assert keys(s3, "forgetful") == []
    assert "there is no registry at `s3://lab/other`" in run("list", "--registry", "s3://lab/other", code=1)
    unencrypted = os.environ.pop("AWS_ALLOW_HTTP")
    assert "AWS_ALLOW_HTTP=true" in run("list", "--registry", "s3://lab/models", code=1)
    os.environ["AWS_ALLOW_HTTP"] = unencrypted


def races(server):
    place = ("--registry", "s3://lab/models")
    published, seen, racing = {}, [], threading.Event()
    racing.set()

    def read():
        while racing.is_set() or not seen:
            for model in result("list", *place):
                versions = model["versions"]
                assert versions == list(range(1, len(versions) + 1)), versions
                out = f"pulled{len(seen)}"
                version = result("pull", "approach", "--out", out, *place)["version"]
                seen.append((version, Path(out, "weights.safetensors").read_bytes()))

    with ThreadPoolExecutor(PUBLISHERS + 1) as pool:
        reader = pool.submit(read)
        try:
            for round_ in itertools.count():
                if round_ >= ROUNDS and server.refused:
                    break
                assert round_ < MOST_ROUNDS, "no publisher ever lost a race"
                weights = [safetensors(f"{round_} {i} ".encode() * 5000) for i in range(PUBLISHERS)]
                runs = [checkpoint(f"run{i}", content) for i, content in enumerate(weights)]
                versions = pool.map(lambda run: result("publish", run, "approach", *place)["version"], runs)
                for version, content in zip(versions, weights):
                    assert published.setdefault(version, content) is content, "a version was given twice"
        finally:
            racing.clear()
        reader.result()
    assert result("list", *place)[0]["versions"] == sorted(published) == list(range(1, round_ * PUBLISHERS + 1))
    assert seen and all(published[version] == weights for version, weights in seen)
    for version, weights in published.items():
        digest = "sha256:" + hashlib.sha256(weights).hexdigest()
        layers = result("show", f"approach@{version}", *place)["manifest"]["layers"]
        assert digest in [layer["digest"] for layer in layers], f"version {version} has the weights of another"
    run("verify", *place)
    print(f"{len(published)} versions, {server.refused} lost races, {len(seen)} pulled in the meantime")


def lost_answers(server):
    for number in range(1, 4):
        said = run("publish", checkpoint("run", safetensors(b"%d" % number)), "approach", "--registry", "s3://lossy")
        assert f"published approach@{number}" in said, said
    assert len(server.answered) == 3
    run("verify", "--registry", "s3://lossy")


def kills(server):
    """Kills publishers at their first request, their second, and so on, until one finishes. Each has a registry of its own, because
    the number of requests grows with the number of versions."""
    killed = 0
    # Small weights, and weights that are uploaded in parts.
    for size, step in ((10, 1), (1_100_000, 3)):
        checkpoint("run", safetensors(b"%08d" % size * size))
        for requests in itertools.count(1, step):
            place = ("--registry", f"s3://lab/killed-{size}-{requests}")
            finished = not server.run_and_kill(requests, "model", "publish", "run", "approach", *place)
            assert result("publish", "run", "approach", *place)["version"] == 1
            run("verify", *place)
            if finished:
                break
            killed += 1
        assert requests > 5, f"published with fewer than {requests} requests"
    print(f"{killed} publishers killed at different requests")


def peak_memory(process):
    """Peak memory of a process in MiB, as far as the system reports it."""
    peak = 0
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status")
        lines = status.read_text().splitlines() if status.exists() else []
        peak = max([peak] + [int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")])
        time.sleep(0.005)
    return peak


def large(s3):
    place = ("--registry", "s3://lab/large")
    weights = safetensors(os.urandom(100_000_000))
    checkpoint("large", weights)
    begun = time.monotonic()
    publisher = subprocess.Popen([FLOWSERVO, "model", "publish", "large", "approach", *place], stdout=subprocess.DEVNULL)
    peak = peak_memory(publisher)
    assert publisher.returncode == 0
    published = time.monotonic()
    run("pull", "approach", "--out", "back", *place)
    pulled = time.monotonic()
    assert Path("back/weights.safetensors").read_bytes() == weights
    print(f"100 MB: published in {published - begun:.1f} s, pulled in {pulled - published:.1f} s, {peak:.0f} MiB at most")
    assert 0 < peak < 100
    layers = result("show", "approach", *place)["manifest"]["layers"]
    digest = next(layer["digest"] for layer in layers if layer["size"] == len(weights)).removeprefix("sha256:")
    damaged = bytearray(weights)
    damaged[50_000_000] ^= 1
    s3.put_object(Bucket="lab", Key=f"large/blobs/sha256/{digest[:2]}/{digest}", Body=bytes(damaged))
    assert "damaged" in run("verify", *place, code=1)
    assert "weights.safetensors" in run("pull", "approach", "--out", "never", *place, code=1)
    assert not Path("never").exists()
    assert "weights.safetensors" in run("copy", "approach", "--to", "other", *place, code=1)
    checkpoint("large", safetensors(os.urandom(20_000_000)))
    run("publish", "large", "approach", *place)


def copies():
    """Between a bucket and a folder, in both directions, and between prefixes."""
    place = ("--registry", "s3://lab/large")
    digest = result("show", "approach@2", *place)["digest"]
    run("copy", "approach@2", "--to", "copied", *place)
    run("copy", "approach@1", "--to", "s3://lab/copied", "--registry", "copied")
    run("copy", "approach@1", "--to", "s3://lab/again", "--registry", "s3://lab/copied")
    for registry in ("copied", "s3://lab/copied", "s3://lab/again"):
        assert result("show", "approach@1", "--registry", registry)["digest"] == digest
        run("verify", "--registry", registry)


def use():
    """Trains a network, publishes it, and uses it from the bucket."""
    place = ("--registry", "s3://lab/used")
    configs = Path(__file__).resolve().parents[2] / "configs"

    def flowservo(*arguments):
        done = subprocess.run([FLOWSERVO, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, f"{arguments}\n{done.stdout}{done.stderr}"
        return done.stdout

    small = ("width=64", "height=48")
    camera = [argument for size in small for argument in ("--set", f"world.camera.{size}")]
    flowservo("dataset", "generate", configs / "datasets/avoid.toml", "--out", "avoid", "--set", "count=16", *camera)
    flowservo("dataset", "replay", "avoid", 3, "--out", "images")
    settings = ("network.width=0.1", "network.head=16", "network.input=[64,48]", "optimizer.batch=4", "phases.0.epochs=1")
    train = ["train", configs / "train/avoid.toml", "--data", "avoid", "--set", "validation=0.25"]
    train += [argument for setting in settings for argument in ("--set", setting)]
    flowservo(*train, "--out", "runs/first")
    run("publish", "runs/first/best", "avoid", *place)
    run("alias", "avoid", "champion", "1", *place)
    image = next(Path("images").glob("*.png"))
    expected = run("predict", "runs/first/best", str(image), "--json")
    for reference in ("avoid", "avoid@1", "avoid:champion"):
        assert run("predict", reference, str(image), "--json", *place) == expected
    flowservo(*train, "--out", "runs/second", "--from", "avoid:champion", *place)
    run("publish", "runs/second/best", "avoid", *place)
    first, second = (result("show", f"avoid@{number}", *place) for number in (1, 2))
    assert second["manifest"]["lineage"]["parent"] == first["digest"]
    run("verify", *place)


def main():
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = Server()
    os.environ.update(
        AWS_ENDPOINT_URL=server.address,
        AWS_ALLOW_HTTP="true",
        AWS_REGION="us-east-1",
        AWS_ACCESS_KEY_ID="anybody",
        AWS_SECRET_ACCESS_KEY="anything",
    )
    s3 = boto3.client("s3", endpoint_url=server.address, region_name="us-east-1")
    for bucket in ("lab", "forgetful", "lossy"):
        s3.create_bucket(Bucket=bucket)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        creation(s3)
        races(server)
        lost_answers(server)
        kills(server)
        large(s3)
        copies()
        use()
    print("the registry in a bucket keeps its promises")


if __name__ == "__main__":
    main()
