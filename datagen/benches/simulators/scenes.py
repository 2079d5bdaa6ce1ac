"""Scene and camera of each image, read from a dataset."""

import json
from dataclasses import dataclass

import numpy as np
import pyarrow.parquet as pq

BAR_HEIGHT = 0.0004  # The cross is two thin boxes, sunk halfway into the target [m].
TABLE_THICKNESS = 0.02


@dataclass
class Solid:
    """A box or a cylinder, with half-extents in meters."""

    kind: str
    half: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray  # x y z w
    color: list


@dataclass
class View:
    """One image: solids, camera and light."""

    solids: list
    robot_from_camera: np.ndarray  # 4 x 4; x right, y down, z forward
    size: tuple
    vertical_fov: float
    towards_light: np.ndarray
    ambient: float
    png: bytes


def rotation(x, y, z, w):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def transform(turn, position):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, position
    return matrix


def robot_from_hand(pose):
    """Converts a hand pose: x y z, and the angles about x, y and z of the robot frame, from looking straight down."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(pose[3:]), np.cos(pose[3:])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return transform(about_z @ about_y @ about_x @ np.diag([1, -1, -1]), pose[:3])


def solids_of(scene):
    """Returns table, obstacles, target and the two bars of its cross."""
    table = scene["table"]
    center = np.subtract(table["center"], [0, 0, TABLE_THICKNESS / 2])
    half = np.array([*table["half_size"], TABLE_THICKNESS / 2])
    solids = [Solid("box", half, center, np.array([0, 0, 0, 1.0]), table["color"])]
    for body in [*scene["obstacles"], scene["target"]]:
        solids += solids_of_body(body)
    return solids


def solids_of_body(body):
    ((shape, sizes),) = body["shape"].items()
    pose, material = body["robot_from_body"], body["material"]
    position, quaternion = np.array(pose["translation"]), np.array(pose["rotation"])
    if shape == "cuboid":
        kind, half = "box", np.array(sizes["half_extents"])
    elif shape == "cylinder":
        kind, half = "cylinder", np.array([sizes["radius"], sizes["radius"], sizes["half_height"]])
    else:
        raise ValueError(f"the comparison does not support the shape {shape}")
    solids = [Solid(kind, half, position, quaternion, material["color"])]
    if cross := material["cross"]:
        bar = cross["width"] / 2
        # A bar ends at the side of a box, or with its corners on the rim of a cylinder.
        reach = half[:2] if kind == "box" else np.full(2, np.sqrt(half[0] ** 2 - bar**2))
        top = position + rotation(*quaternion) @ [0, 0, half[2]]
        for sides in ([reach[0], bar], [bar, reach[1]]):
            solids.append(Solid("box", np.array([*sides, BAR_HEIGHT / 2]), top, quaternion, cross["color"]))
    return solids


def views_of(folder):
    """Returns all images of an approach dataset, in row order."""
    columns = ["index", "scene", "camera", "hand_from_camera"]
    columns += [f"{kind}_{when}" for kind in ("pose", "image") for when in ("current", "goal")]
    views = []
    for row in pq.read_table(f"{folder}/data", columns=columns).sort_by("index").to_pylist():
        scene, (_, focal, *center) = json.loads(row["scene"]), row["camera"]
        mount = transform(rotation(*row["hand_from_camera"][3:]), row["hand_from_camera"][:3])
        width, height = (round(2 * c) for c in center)
        for when in ("current", "goal"):
            views.append(
                View(
                    solids_of(scene),
                    robot_from_hand(np.array(row[f"pose_{when}"])) @ mount,
                    (width, height),
                    2 * np.arctan(height / 2 / focal),
                    np.array(scene["light"]["towards_light"]),
                    scene["light"]["ambient"],
                    row[f"image_{when}"]["bytes"],
                )
            )
    return views
