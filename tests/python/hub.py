"""Reads an exported model as the Hugging Face Hub does: hub.py EXPORTED PULLED"""

import json
import sys
from pathlib import Path

from huggingface_hub import ModelCard
from safetensors import safe_open

exported, pulled = Path(sys.argv[1]), Path(sys.argv[2])
manifest = json.loads((exported / "manifest.json").read_text())
data = ModelCard.load(exported / "README.md").data
assert (data.license, data.library_name) == ("apache-2.0", "flowservo"), data
assert data.datasets == sorted(manifest["lineage"]["datasets"]), data.datasets
found = {result.metric_type: result.metric_value for result in data.eval_results}
assert found == manifest["metrics"] and found, found
with safe_open(exported / "model.safetensors", "numpy") as ours, safe_open(pulled / "weights.safetensors", "numpy") as theirs:
    assert list(ours.keys()) == list(theirs.keys())
assert (exported / "config.json").read_bytes() == (pulled / "config.json").read_bytes()
print("the Hugging Face library reads the card and its", len(found), "metrics")
