"""Compares docs/load_in_pytorch.py with the program: models.py FLOWSERVO IMAGES MODEL..."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

TOLERANCE = 1e-4

place = Path(__file__).parents[2] / "docs" / "load_in_pytorch.py"
spec = importlib.util.spec_from_file_location("load_in_pytorch", place)
example = importlib.util.module_from_spec(spec)
spec.loader.exec_module(example)


def predicted_by(program, model, images):
    command = [program, "model", "predict", str(model), *images, "--json"]
    result = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
    return result.get("pose_change") or result["avoidance_map"]


def main():
    program, folder, models = sys.argv[1], Path(sys.argv[2]), [Path(model) for model in sys.argv[3:]]
    # The stored images are left out: they have the same pixels.
    pictures = sorted(str(path) for path in folder.iterdir() if "stored" not in path.name)
    assert len(pictures) == 4, pictures
    failed = 0
    for model in models:
        config = json.loads((model / "config.json").read_text())
        count = len(config["input"]["images"])
        scale = max(config["output"].get("scale", [1.0]))
        worst = 0.0
        for images in [pictures[:count], pictures[-count:], pictures[1 : 1 + count]]:
            ours, theirs = predicted_by(program, model, images), example.predict(model, images).tolist()
            assert len(ours) == len(theirs) and any(ours), (ours, theirs)
            worst = max(worst, *(abs(a - b) / scale for a, b in zip(ours, theirs)))
        failed += worst > TOLERANCE
        print(f"{model.name:<14} {config['network']['trunk']:<12} {worst:9.1e} {'FAILED' if worst > TOLERANCE else ''}")
    sys.exit(f"{failed} models differ by more than {TOLERANCE:g}" if failed else 0)


if __name__ == "__main__":
    main()
