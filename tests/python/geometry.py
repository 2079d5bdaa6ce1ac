"""Recomputes the numbers in the rows independently of the program."""

import io
import json
import math

import numpy as np
from PIL import Image

from folder import holds, same

CHECKS = ["the_scene_is_in_the_row", "the_camera_is_in_the_row", "the_cross_is_where_the_numbers_say"]
CHECKS_OF = {
    "approach": ["twists_are_the_logarithm_of_the_motion", "differences_are_goal_minus_current"],
    "avoidance": ["avoidance_values_follow_equation_1"],
}


def near(what, found, expected, tolerance):
    found, expected = np.asarray(found), np.asarray(expected)
    holds(f"the shape {expected.shape} of {what}", found.shape == expected.shape, found.shape)
    apart = np.abs(found - expected).max(initial=0)
    holds(f"{what} = {expected.tolist()} within {tolerance}", apart <= tolerance, found.tolist())


def turn(axis, angle):
    """Rotation about a coordinate axis."""
    matrix, (i, j) = np.eye(3), [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[j, i] = math.sin(angle)
    matrix[i, j] = -matrix[j, i]
    return matrix


def transform(rotation, position):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def robot_from_hand(pose):
    """From x, y, z and the angles about the robot's x, y and z axes, applied in this order to a hand that points down."""
    rotation = turn(2, pose[5]) @ turn(1, pose[4]) @ turn(0, pose[3]) @ np.diag([1, -1, -1])
    return transform(rotation, pose[:3])


def from_quaternion(x, y, z, w):
    """The rotation as p -> q p q*, written out for the unit vectors."""
    rotate = lambda p: p + 2 * np.cross([x, y, z], np.cross([x, y, z], p) + w * np.asarray(p))
    return np.array([rotate(axis) for axis in np.eye(3)]).T


def from_json(isometry):
    return transform(from_quaternion(*isometry["rotation"]), isometry["translation"])


def exponential(twist):
    """Matrix exponential of a twist as a power series, without a closed form."""
    x, y, z = twist[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = twist[:3]
    term = total = np.eye(4)
    for n in range(1, 40):
        term = term @ generator / n
        total = total + term
    return total


def twists_are_the_logarithm_of_the_motion(folder):
    for number, row in enumerate(folder.rows):
        current, goal = (robot_from_hand(row[name]) for name in ("pose_current", "pose_goal"))
        near(f"exp(twist) of row {number}", exponential(row["twist"]), np.linalg.inv(current) @ goal, 1e-12)
        holds(f"a rotation below pi in row {number}", np.linalg.norm(row["twist"][3:]) < math.pi, row["twist"])


def differences_are_goal_minus_current(folder):
    for number, row in enumerate(folder.rows):
        expected = np.subtract(row["pose_goal"], row["pose_current"])
        near(f"difference of row {number}", row["difference"], expected, 1e-12)


def half_sides(shape):
    ((name, sizes),) = shape.items()
    if name == "cuboid":
        return name, np.array(sizes["half_extents"])
    radius = sizes["radius"]
    return name, np.array([radius, radius, sizes.get("half_height", radius)])


def the_scene_is_in_the_row(folder):
    for number, row in enumerate(folder.rows):
        scene = json.loads(row["scene"])
        target = scene["target"]
        name, half = half_sides(target["shape"])
        same(f"target_shape of row {number}", row["target_shape"], name)
        near(f"target_size of row {number}", row["target_size"], 2 * half, 1e-15)
        near(f"target_position of row {number}", row["target_position"], target["robot_from_body"]["translation"], 0)
        same(f"obstacles of row {number}", row["obstacles"], len(scene["obstacles"]))
        for body in [target, *scene["obstacles"]]:
            bottom = body["robot_from_body"]["translation"][2] - half_sides(body["shape"])[1][2]
            near(f"height of a body's bottom in row {number}", bottom, scene["table"]["center"][2], 1e-12)


def the_camera_is_in_the_row(folder):
    camera = folder.config["world"]["camera"]
    half_width, half_height = camera["width"] / 2, camera["height"] / 2
    focal = half_width / math.tan(math.radians(camera["horizontal_fov_deg"]) / 2)
    for number, row in enumerate(folder.rows):
        near(f"camera of row {number}", row["camera"], [focal, focal, half_width, half_height], 1e-9)
        # Behind the hand, with the same viewing direction.
        position, quaternion = row["hand_from_camera"][:3], row["hand_from_camera"][3:]
        near(f"position of the camera in row {number}", position, [0, 0, -camera["behind_hand_mm"] / 1000], 1e-12)
        near(f"viewing direction of the camera in row {number}", from_quaternion(*quaternion)[:, 2], [0, 0, 1], 1e-12)


def the_cross_is_where_the_numbers_say(folder):
    """The image is red where pose, camera and scene place the center of the target's top face."""
    red = seen = 0
    for row in folder.rows:
        fx, fy, cx, cy = row["camera"]
        target = json.loads(row["scene"])["target"]
        top = from_json(target["robot_from_body"]) @ [0, 0, half_sides(target["shape"])[1][2], 1]
        mount = transform(from_quaternion(*row["hand_from_camera"][3:]), row["hand_from_camera"][:3])
        for image, pose in folder.views:
            x, y, z, _ = np.linalg.inv(robot_from_hand(row[pose]) @ mount) @ top
            u, v = math.floor(cx + fx * x / z), math.floor(cy + fy * y / z)
            pixels = np.asarray(Image.open(io.BytesIO(row[image]["bytes"]))).astype(int)
            if 0 <= v < pixels.shape[0] and 0 <= u < pixels.shape[1]:
                seen += 1
                red += pixels[v, u, 0] > 2 * max(pixels[v, u, 1:])
    # Obstacles may hide it.
    holds(f"a red pixel in nearly all of {seen} images", red >= 0.95 * seen > 0, red)


def spiral(count):
    """The generalized spiral of Rakhmanov, Saff and Zhou (1994)."""
    points, longitude = [], 0.0
    for k in range(1, count + 1):
        height = -1 + 2 * (k - 1) / (count - 1)
        colatitude = math.acos(height)
        ends = k in (1, count)
        longitude = 0.0 if ends else (longitude + 3.6 / math.sqrt(count * (1 - height**2))) % (2 * math.pi)
        ring = math.sin(colatitude)
        points.append([ring * math.cos(longitude), ring * math.sin(longitude), height])
    return np.array(points)


def elements(obstacle, side):
    """Centers of the cubes that fill an obstacle, in the robot frame."""
    name, half = half_sides(obstacle["shape"])
    counts = [max(1, math.floor(2 * h / side + 0.5)) for h in half]
    axes = [(np.arange(count) - (count - 1) / 2) * side for count in counts]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if name == "cylinder":
        grid = grid[np.hypot(grid[:, 0], grid[:, 1]) <= half[0]]
    pose = from_json(obstacle["robot_from_body"])
    return grid @ pose[:3, :3].T + pose[:3, 3]


def origins(hand):
    """Palm center, outer ends of the fingertips, corners of the palm's front face, in the hand frame [m]."""
    palm, finger = np.array(hand["palm_mm"]) / 2000, np.array(hand["finger_mm"]) / 1000
    outside = hand["opening_mm"] / 2000 + finger[1]
    tips = [[0, sign * outside, finger[2]] for sign in (1, -1)]
    corners = [[sx * palm[0], sy * palm[1], 0] for sx in (1, -1) for sy in (1, -1)]
    return np.array([[0, 0, 0], *tips, *corners])


def avoidance_values_follow_equation_1(folder):
    world = folder.config["world"]
    points = spiral(world["avoidance"]["measuring_points"])
    for number, row in enumerate(folder.rows[:100]):
        obstacles = json.loads(row["scene"])["obstacles"]
        cubes = [elements(obstacle, world["avoidance"]["element_mm"] / 1000) for obstacle in obstacles]
        expected = np.zeros(len(points))
        if cubes:
            pose = robot_from_hand(row["pose"])
            seen_from = origins(world["hand"]) @ pose[:3, :3].T + pose[:3, 3]
            away = (np.concatenate(cubes)[None] - seen_from[:, None]).reshape(-1, 3)
            away /= np.linalg.norm(away, axis=1, keepdims=True)
            expected = np.clip((points @ away.T).max(axis=1), 0, 1)
        near(f"values of row {number}", row["values"], expected, 1e-6)
