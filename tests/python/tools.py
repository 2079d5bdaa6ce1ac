"""Opens the folder with `datasets`, DuckDB and polars."""

import json
from itertools import islice

import datasets
import duckdb
import numpy as np
import polars as pl
import pyarrow.parquet as pq
from PIL import Image

from folder import IMAGE, holds, same

CHECKS = [
    "datasets_opens_the_folder_with_the_features_of_the_card",
    "datasets_decodes_images",
    "datasets_has_the_rows_that_pyarrow_has",
    "datasets_streams",
    "datasets_opens_the_files_without_the_card",
    "duckdb_reads_images_lists_and_groups",
    "polars_reads_arrays_and_structs",
]


def feature_of_card(item):
    """One item of `dataset_info.features`."""
    if "list" in item:
        return datasets.List(datasets.Value(item["list"]), length=item["length"])
    kind = item["dtype"]
    if isinstance(kind, dict):
        names = kind["class_label"]["names"]
        return datasets.ClassLabel(names=[names[str(i)] for i in range(len(names))])
    return datasets.Image() if kind == "image" else datasets.Value(kind)


def features_of_card(folder):
    return {item["name"]: feature_of_card(item) for item in folder.card["dataset_info"]["features"]}


def expected_rows(folder, split):
    return [row for file in folder.splits[split] for row in pq.read_table(file).to_pylist()]


def opened(folder, **options):
    return datasets.load_dataset(str(folder.path), **options)


def datasets_opens_the_folder_with_the_features_of_the_card(folder):
    loaded = opened(folder)
    same("splits", sorted(loaded), sorted(folder.splits))
    expected = features_of_card(folder)
    for split, rows in loaded.items():
        same(f"columns of {split}", rows.column_names, list(expected))
        for name, feature in rows.features.items():
            same(f"feature {name} of {split}", feature, expected[name])
        same(f"names of the motions of {split}", rows.features["motion"].names, [m["name"] for m in folder.config["motions"]])
    written = json.loads(pq.ParquetFile(folder.files[0]).metadata.metadata[b"huggingface"])
    for name, feature in datasets.Features.from_dict(written["info"]["features"]).items():
        same(f"feature {name} in the files", feature, expected[name])


def datasets_decodes_images(folder):
    camera = folder.config["world"]["camera"]
    for split, rows in opened(folder).items():
        for name in folder.image_columns:
            image = rows[0][name]
            holds(f"a picture in {name} of {split}", isinstance(image, Image.Image), type(image))
            same(f"size of {name} of {split}", image.size, (camera["width"], camera["height"]))


def datasets_has_the_rows_that_pyarrow_has(folder):
    for split, rows in opened(folder).items():
        found, expected = rows.with_format("arrow")[:].to_pylist(), expected_rows(folder, split)
        same(f"rows of {split}", len(found), len(expected))
        for number, (one, other) in enumerate(zip(found, expected)):
            for name in other:
                same(f"{name} of row {number} of {split}", one[name], other[name])


def datasets_streams(folder):
    camera = folder.config["world"]["camera"]
    for split in folder.splits:
        streamed = opened(folder, split=split, streaming=True)
        same(f"features of {split}", dict(streamed.features), features_of_card(folder))
        expected = expected_rows(folder, split)
        for number, row in enumerate(islice(streamed, 5)):
            for name, value in row.items():
                if isinstance(value, Image.Image):
                    same(f"size of {name} of row {number}", value.size, (camera["width"], camera["height"]))
                else:
                    same(f"{name} of row {number}", value, expected[number][name])
        same(f"rows of {split}", sum(1 for _ in streamed.remove_columns(folder.image_columns)), len(expected))


def datasets_opens_the_files_without_the_card(folder):
    files = {split: [str(file) for file in files] for split, files in folder.splits.items()}
    loaded = datasets.load_dataset("parquet", data_files=files)
    for split, rows in loaded.items():
        same(f"features of {split}", dict(rows.features), features_of_card(folder))
        for name in folder.image_columns:
            holds(f"a picture in {name} of {split}", isinstance(rows[-1][name], Image.Image), rows[-1][name])


def duckdb_reads_images_lists_and_groups(folder):
    # A view, so that queries look as people would type them.
    connection = duckdb.connect()
    connection.execute(f"create view rows as select * from '{folder.path}/data/*.parquet'")
    ask = lambda question: connection.execute(question).fetchall()
    same("rows", ask("select count(*), min(index), max(index) from rows"), [(len(folder.rows), 0, len(folder.rows) - 1)])
    for name in folder.image_columns:
        found = ask(f"select {name}.path, octet_length({name}.bytes) from rows order by index")
        same(name, found, [(row[name]["path"], len(row[name]["bytes"])) for row in folder.rows])
    label = "twist" if folder.is_approach else "values"
    found = ask(f"select {label}[1], {label}[6], list_sum({label}::double[]), len({label}) from rows order by index")
    for number, (row, (first, sixth, total, length)) in enumerate(zip(folder.rows, found)):
        values = row[label]
        same(f"{label} of row {number}", (first, sixth, length), (values[0], values[5], len(values)))
        holds(f"{sum(values)} as the sum of {label} of row {number}", np.isclose(total, sum(values), atol=1e-9), total)
    found = ask("select motion, count(*), sum(obstacles)::int, max(target_shape) from rows group by motion order by motion")
    for motion, *numbers in found:
        of = [row for row in folder.rows if row["motion"] == motion]
        expected = [len(of), sum(row["obstacles"] for row in of), max(row["target_shape"] for row in of)]
        same(f"aggregates of motion {motion}", numbers, expected)
    found = ask("select scene->>'$.target.material.color[0]', (scene->'$.obstacles').json_array_length() from rows order by index")
    expected = [json.loads(row["scene"]) for row in folder.rows]
    expected = [(scene["target"]["material"]["color"][0], len(scene["obstacles"])) for scene in expected]
    same("what DuckDB finds in scenes", [(float(color), count) for color, count in found], expected)
    keys = {key for (key,) in ask(f"select key from parquet_kv_metadata('{folder.files[0]}')")}
    holds("the key huggingface", b"huggingface" in keys, keys)


def polars_reads_arrays_and_structs(folder):
    files = str(folder.path / "data" / "*.parquet")
    frame = pl.read_parquet(files)
    image = pl.Struct({"bytes": pl.Binary, "path": pl.String})
    for name, kind in folder.columns.items():
        if kind == IMAGE:
            same(f"type of {name}", frame.schema[name], image)
        elif name.startswith(("pose", "joints", "twist", "difference")):
            same(f"type of {name}", frame.schema[name], pl.Array(pl.Float64, 6))
        elif name == "values":
            same(f"type of {name}", frame.schema[name], pl.Array(pl.Float32, 180))
    for number, (found, expected) in enumerate(zip(frame.to_dicts(), folder.rows, strict=True)):
        for name in expected:
            same(f"{name} of row {number}", found[name], expected[name])
    name = folder.image_columns[0]
    second = pl.scan_parquet(files).filter(pl.col("motion") == 1).select(pl.col(name).struct.field("path"))
    expected = [row[name]["path"] for row in folder.rows if row["motion"] == 1]
    same("paths of the second motion", second.collect()["path"].to_list(), expected)
