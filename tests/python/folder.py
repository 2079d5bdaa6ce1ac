"""A dataset folder, read with pyarrow and a YAML parser, and the columns it must have."""

import json
import re
from functools import cached_property
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

FILE_NAME = re.compile(r"(?P<split>\w+)-(?P<number>\d{5})-of-(?P<count>\d{5})\.parquet")


class Unexpected(Exception):
    """A check failed."""


def same(what, found, expected):
    if found != expected:
        shorten = lambda value: text if len(text := repr(value)) <= 400 else f"{text[:400]}..."
        raise Unexpected(f"{what}: expected {shorten(expected)}, found {shorten(found)}")


def holds(what, condition, found):
    if not condition:
        raise Unexpected(f"expected {what}, found {found!r}")


IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
POSE = JOINTS = TWIST = pa.list_(pa.field("item", pa.float64()), 6)

# Types of the columns that every row has. There may be others.
IDENTITY = dict(index=pa.uint64(), seed=pa.uint64(), motion=pa.int64())
SURROUNDINGS = dict(
    target_shape=pa.string(),
    target_size=pa.list_(pa.float64(), 3),
    target_position=pa.list_(pa.float64(), 3),
    obstacles=pa.uint64(),
    scene=pa.string(),
    camera=pa.list_(pa.float64(), 4),
    hand_from_camera=pa.list_(pa.float64(), 7),
)
APPROACH = dict(image_current=IMAGE, image_goal=IMAGE, twist=TWIST, difference=TWIST)
APPROACH |= dict(pose_current=POSE, pose_goal=POSE, joints_current=JOINTS, joints_goal=JOINTS)
AVOIDANCE = dict(image=IMAGE, values=pa.list_(pa.float32(), 180), pose=POSE, joints=JOINTS)


class Folder:
    """A dataset."""

    def __init__(self, path):
        self.path = Path(path)
        self.info = json.loads((self.path / "dataset.json").read_text())
        self.config = self.info["config"]
        self.kind = self.config["kind"]
        self.is_approach = self.kind == "approach"
        self.columns = IDENTITY | (APPROACH if self.is_approach else AVOIDANCE) | SURROUNDINGS
        self.image_columns = [name for name, kind in self.columns.items() if kind == IMAGE]
        # Each image column with the column of the hand pose that it was taken from.
        self.views = [(name, name.replace("image", "pose")) for name in self.image_columns]

    @cached_property
    def files(self):
        """The Parquet files, in order."""
        return sorted((self.path / "data").iterdir())

    @cached_property
    def splits(self):
        """Files of each split, according to their names."""
        splits = {}
        for file in self.files:
            name = FILE_NAME.fullmatch(file.name)
            splits.setdefault(name["split"] if name else file.name, []).append(file)
        return splits

    @cached_property
    def table(self):
        """All rows, as pyarrow reads them."""
        return pa.concat_tables(pq.read_table(file) for file in self.files)

    @cached_property
    def rows(self):
        return self.table.to_pylist()

    @cached_property
    def card(self):
        """The front matter of the card."""
        _, front_matter, _ = (self.path / "README.md").read_text().split("---\n", 2)
        return yaml.safe_load(front_matter)
