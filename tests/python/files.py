"""Checks of file names, Parquet, card and PNG."""

import base64
import io
import json
import struct
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from folder import FILE_NAME, holds, same

ROWS_PER_GROUP = 128
KEY = b"huggingface"

CHECKS = [
    "files_are_named_by_the_convention",
    "every_row_has_the_published_columns",
    "every_field_is_nullable_and_nothing_is_null",
    "footer_and_arrow_schema_describe_the_features",
    "row_groups_are_small_and_indexed",
    "images_are_stored_uncompressed",
    "the_card_describes_the_files",
    "images_are_plain_png_that_pillow_and_zlib_decode_alike",
]


def files_are_named_by_the_convention(folder):
    for split, files in folder.splits.items():
        names = [FILE_NAME.fullmatch(file.name) for file in files]
        holds("names as train-00000-of-00003.parquet", all(names), [file.name for file in files])
        same(f"numbers of {split}", [int(name["number"]) for name in names], list(range(len(files))))
        same(f"counts of {split}", {int(name["count"]) for name in names}, {len(files)})
    recorded = [folder.path / file["path"] for file in folder.info["files"]]
    same("files in dataset.json", sorted(recorded), folder.files)


def every_row_has_the_published_columns(folder):
    for file in folder.files:
        schema = pq.read_schema(file)
        for name, kind in folder.columns.items():
            holds(f"a column {name} in {file.name}", name in schema.names, schema.names)
            same(f"type of {name} in {file.name}", schema.field(name).type, kind)
    same("rows", folder.table.num_rows, folder.config["count"])
    same("index", folder.table["index"].to_pylist(), list(range(folder.config["count"])))
    same("seed", set(folder.table["seed"].to_pylist()), {folder.config["seed"]})
    motions = range(len(folder.config["motions"]))
    same("unknown motions", set(folder.table["motion"].to_pylist()) - set(motions), set())


def every_field_is_nullable_and_nothing_is_null(folder):
    def fields(field):
        children = [field.type.field(i) for i in range(field.type.num_fields)]
        return [field] + [below for child in children for below in fields(child)]

    for file in folder.files:
        schema = pq.read_schema(file)
        every = [field for name in schema.names for field in fields(schema.field(name))]
        same(f"fields of {file.name} that are not nullable", [f.name for f in every if not f.nullable], [])
    for name, column in zip(folder.table.column_names, folder.table.columns):
        flat = column.combine_chunks()
        children = flat.flatten() if pa.types.is_struct(flat.type) else [getattr(flat, "values", flat)]
        same(f"nulls in {name}", [part.null_count for part in [flat, *children]], [0] * (1 + len(children)))


def footer_and_arrow_schema_describe_the_features(folder):
    for file in folder.files:
        footer = pq.ParquetFile(file).metadata.metadata
        schema = pa.ipc.read_schema(pa.py_buffer(base64.b64decode(footer[b"ARROW:schema"])))
        holds(f"{KEY} in the footer of {file.name}", KEY in footer, list(footer))
        holds(f"{KEY} in the Arrow schema of {file.name}", KEY in (schema.metadata or {}), schema.metadata)
        same(f"{KEY} of footer and schema of {file.name}", footer[KEY], schema.metadata[KEY])
        features = json.loads(footer[KEY])["info"]["features"]
        same(f"columns with features in {file.name}", sorted(features), sorted(schema.names))


def row_groups_are_small_and_indexed(folder):
    for file in folder.files:
        metadata = pq.ParquetFile(file).metadata
        groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
        holds(
            f"row groups of at most {ROWS_PER_GROUP} rows in {file.name}",
            all(group.num_rows <= ROWS_PER_GROUP for group in groups),
            [group.num_rows for group in groups],
        )
        for column in (group.column(i) for group in groups for i in range(group.num_columns)):
            path = column.path_in_schema
            same(f"offset index of {path} in {file.name}", column.has_offset_index, True)
            if not path.endswith(".bytes"):
                same(f"column index of {path} in {file.name}", column.has_column_index, True)


def images_are_stored_uncompressed(folder):
    for file in folder.files:
        metadata = pq.ParquetFile(file).metadata
        groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
        columns = [group.column(i) for group in groups for i in range(group.num_columns)]
        images = [column for column in columns if column.path_in_schema.endswith(".bytes")]
        paths = {column.path_in_schema for column in images}
        same(f"columns of image bytes in {file.name}", paths, {f"{name}.bytes" for name in folder.image_columns})
        for column in images:
            what = f"{column.path_in_schema} in {file.name}"
            same(f"compression of {what}", column.compression, "UNCOMPRESSED")
            same(f"encodings of {what}", set(column.encodings) - {"RLE"}, {"PLAIN"})
            same(f"dictionary of {what}", column.has_dictionary_page, False)
            same(f"statistics of {what}", column.is_stats_set, False)


def the_card_describes_the_files(folder):
    card, rows = folder.card, folder.config["count"]
    for key in ("license", "pretty_name", "tags"):
        holds(f"{key} on the card", bool(card.get(key)), card.get(key))
    same("task_categories", card["task_categories"], ["robotics"])
    same("size_categories", card["size_categories"], ["n<1K" if rows < 1000 else "1K<n<10K"])
    (config,) = card["configs"]
    info = card["dataset_info"]
    same("config_name of dataset_info", info.get("config_name", "default"), config["config_name"])
    stated = {item["split"]: sorted(folder.path.glob(item["path"])) for item in config["data_files"]}
    same("files of the splits on the card", stated, folder.splits)
    found = {s: sum(pq.ParquetFile(file).metadata.num_rows for file in files) for s, files in folder.splits.items()}
    same("rows of the splits", {item["name"]: item["num_examples"] for item in info["splits"]}, found)
    same("download_size", info["download_size"], sum(file.stat().st_size for file in folder.files))
    same("dataset_size", info["dataset_size"], sum(item["num_bytes"] for item in info["splits"]))


def chunks_of(png):
    """Types and contents of a PNG file's chunks."""
    same("first bytes of an image", png[:8], b"\x89PNG\r\n\x1a\n")
    chunks, start = [], 8
    while start < len(png):
        (length,) = struct.unpack_from(">I", png, start)
        body = png[start + 4 : start + 8 + length]
        (crc,) = struct.unpack_from(">I", png, start + 8 + length)
        same("checksum of a chunk", crc, zlib.crc32(body))
        chunks.append((body[:4], body[4:]))
        start += 12 + length
    return chunks


def unfiltered(lines, width, height):
    """Pixels of 8-bit RGB scan lines, without the filters of the PNG specification, section 9."""
    lines = np.frombuffer(lines, np.uint8).reshape(height, 1 + 3 * width)
    image = np.zeros((height + 1, width + 1, 3), int)
    for y, (method, line) in enumerate(zip(lines[:, 0], lines[:, 1:].reshape(height, width, 3)), 1):
        for x in range(1, width + 1):
            left, up, corner = image[y, x - 1], image[y - 1, x], image[y - 1, x - 1]
            guess = left + up - corner
            order = [abs(guess - left), abs(guess - up), abs(guess - corner)]
            paeth = np.choose(np.argmin(order, axis=0), [left, up, corner])
            image[y, x] = (line[x - 1] + [0, left, up, (left + up) // 2, paeth][method]) % 256
    return image[1:, 1:]


def images_are_plain_png_that_pillow_and_zlib_decode_alike(folder):
    camera = folder.config["world"]["camera"]
    size = (camera["width"], camera["height"])
    header = struct.pack(">IIBBBBB", *size, 8, 2, 0, 0, 0)
    for name in folder.image_columns:
        for number, row in enumerate(folder.rows):
            what = f"{name} of row {number}"
            chunks = chunks_of(row[name]["bytes"])
            kinds = [kind for kind, _ in chunks]
            # No gamma, color profile or time, which decoders treat differently.
            same(f"kinds of chunks of {what}", [*dict.fromkeys(kinds)], [b"IHDR", b"IDAT", b"IEND"])
            same(f"header of {what}", chunks[0][1], header)
            lines = zlib.decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"))
            pillow = Image.open(io.BytesIO(row[name]["bytes"]))
            pixels = np.asarray(pillow)
            same(f"size and mode of {what}", (pillow.size, pillow.mode), (size, "RGB"))
            if number % 100 == 0:
                same(f"{what}", pixels.tolist(), unfiltered(lines, *size).tolist())
            holds(f"more than one color in {what}", np.ptp(pixels) > 0, pixels[0, 0].tolist())
        paths = [row[name]["path"] for row in folder.rows]
        same(f"duplicate paths in {name}", len(paths) - len(set(paths)), 0)
