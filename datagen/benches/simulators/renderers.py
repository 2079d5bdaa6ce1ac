"""PyBullet and MuJoCo, each in its own process: `renderers.py NAME FOLDER PART PARTS [MULTISAMPLES]`.

Answers each line of standard input with a line of JSON:

    measure      renders, encodes and stores its part of the images; returns the seconds of each stage
    images N     writes the first N images as FOLDER/NAME-0.png, ...

The conditions favor the simulators. Scenes and poses are read and prepared beforehand. A scene is built once for both of
its images. MuJoCo compiles its model once, and only sizes, colors and poses change. Physics is not simulated. Shadows,
specular light and segmentation are off. Anti-aliasing is the default of each: 4 samples per pixel in MuJoCo, none in PyBullet.
"""

import io
import json
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from scenes import views_of

NEAR, FAR = 0.01, 3.0
PNG_LEVELS = (1, 6)


def opengl_from_robot(view):
    """View matrix of an OpenGL camera, which has y up and looks along -z."""
    return np.diag([1, -1, -1, 1]) @ np.linalg.inv(view.robot_from_camera)


def write_cylinder(path, radius, half_height, sides=28):
    """Writes a mesh with as many sides as MuJoCo's cylinder. The bottom is omitted, because it is never visible."""
    turns = [2 * np.pi * side / sides for side in range(sides)]
    rim = [(np.cos(turn), np.sin(turn)) for turn in turns]
    lines = [f"v {radius * x} {radius * y} {height}" for height in (half_height, -half_height) for x, y in rim]
    lines += ["vt 0 0", *(f"vn {x} {y} 0" for x, y in rim), "vn 0 0 1"]
    for side, after in ((side, side % sides + 1) for side in range(1, sides + 1)):
        corner = lambda vertex, normal: f"{vertex}/1/{normal}"
        top, next_top = corner(side, side), corner(after, after)
        foot, next_foot = corner(side + sides, side), corner(after + sides, after)
        lines += [f"f {top} {foot} {next_top}", f"f {next_top} {foot} {next_foot}"]
        if 1 < side < sides:
            lines.append("f " + " ".join(corner(vertex, sides + 1) for vertex in (1, side, after)))
    path.write_text("\n".join(lines) + "\n")


class PyBullet:
    """PyBullet with its software rasterizer."""

    def __init__(self, views):
        import pybullet

        self.bullet = pybullet
        self.meshes = tempfile.TemporaryDirectory()
        pybullet.connect(pybullet.DIRECT)
        self.renderer = pybullet.ER_TINY_RENDERER
        self.scene = None
        self.bodies = []
        self.views = views
        self.prepared = [self.prepare(view) for view in views]

    def prepare(self, view):
        """Prepares the arguments of all calls."""
        (width, height), tangent = view.size, np.tan(view.vertical_fov / 2)
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = height / width / tangent, 1 / tangent
        projection[2, 2:] = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
        projection[3, 2] = -1
        camera = dict(
            width=width,
            height=height,
            viewMatrix=opengl_from_robot(view).T.ravel().tolist(),
            projectionMatrix=projection.T.ravel().tolist(),
            renderer=self.renderer,
            shadow=0,
            lightDirection=view.towards_light.tolist(),
            lightColor=[1, 1, 1],
            lightAmbientCoeff=view.ambient,
            lightDiffuseCoeff=1 - view.ambient,
            lightSpecularCoeff=0,
            flags=self.bullet.ER_NO_SEGMENTATION_MASK,
        )
        return [self.shape(solid) for solid in view.solids], camera

    def shape(self, solid):
        shape = dict(rgbaColor=[*solid.color, 1], specularColor=[0, 0, 0])
        if solid.kind == "box":
            shape |= dict(shapeType=self.bullet.GEOM_BOX, halfExtents=solid.half.tolist())
        else:
            # PyBullet's own cylinder is a coarse hull that is a millimeter too high and hides the cross. Its EGL plugin draws
            # only meshes from files, and ignores scales.
            radius, _, half_height = solid.half
            mesh = Path(self.meshes.name) / f"{radius}-{half_height}.obj"
            write_cylinder(mesh, radius, half_height)
            shape |= dict(shapeType=self.bullet.GEOM_MESH, fileName=str(mesh))
        return shape, dict(basePosition=solid.position.tolist(), baseOrientation=solid.quaternion.tolist())

    def render(self, number):
        shapes, camera = self.prepared[number]
        if self.scene != number // 2:
            self.scene = number // 2
            for body in self.bodies:
                self.bullet.removeBody(body)
            self.bodies = [
                self.bullet.createMultiBody(baseVisualShapeIndex=self.bullet.createVisualShape(**shape), **pose)
                for shape, pose in shapes
            ]
        width, height, pixels, _, _ = self.bullet.getCameraImage(**camera)
        return np.ascontiguousarray(np.reshape(pixels, (height, width, 4))[:, :, :3].astype(np.uint8, copy=False))


class PyBulletEgl(PyBullet):
    """PyBullet with OpenGL, through its EGL plugin."""

    def __init__(self, views):
        super().__init__(views)
        import importlib.util

        plugin = self.bullet.loadPlugin(importlib.util.find_spec("eglRenderer").origin, "_eglRendererPlugin")
        if plugin < 0:
            sys.exit("PyBullet's EGL renderer failed to start")
        for _, camera in self.prepared:
            camera["renderer"] = self.bullet.ER_BULLET_HARDWARE_OPENGL


class MuJoCo:
    """MuJoCo with OpenGL on EGL."""

    def __init__(self, views, multisamples=4):
        import mujoco

        most = {kind: max(self.count(view, kind) for view in views) for kind in ("box", "cylinder")}
        self.model = mujoco.MjModel.from_xml_string(self.xml(views[0], most, multisamples))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        width, height = views[0].size
        self.renderer = mujoco.Renderer(self.model, height, width)
        for flag in ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE"):
            self.renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        self.geoms = [("box", i) for i in range(most["box"])] + [("cylinder", i) for i in range(most["cylinder"])]
        self.scene = None
        self.prepared = [self.prepare(view) for view in views]

    @staticmethod
    def count(view, kind):
        return sum(solid.kind == kind for solid in view.solids)

    @staticmethod
    def xml(view, most, multisamples):
        ambient, (width, height) = view.ambient, view.size
        light = " ".join(str(-x) for x in view.towards_light)
        geoms = "".join(f'<geom type="{kind}" size="1 1 1"/>' * most[kind] for kind in ("box", "cylinder"))
        return f"""<mujoco>
            <statistic extent="1" center="0 0 0"/>
            <visual>
                <global offwidth="{width}" offheight="{height}" fovy="{np.degrees(view.vertical_fov)}"/>
                <map znear="{NEAR}" zfar="{FAR}"/>
                <quality offsamples="{multisamples}" shadowsize="0"/>
                <headlight active="0"/>
            </visual>
            <worldbody>
                <light directional="true" castshadow="false" pos="0 0 2" dir="{light}" specular="0 0 0"
                    ambient="{ambient} {ambient} {ambient}" diffuse="{1 - ambient} {1 - ambient} {1 - ambient}"/>
                <camera fovy="{np.degrees(view.vertical_fov)}"/>{geoms}
            </worldbody>
        </mujoco>"""

    def prepare(self, view):
        """Prepares the arrays of all geoms and of the camera. Unused geoms are transparent."""
        from scenes import rotation

        size, color = np.ones((len(self.geoms), 3)), np.zeros((len(self.geoms), 4))
        position, turn = np.zeros((len(self.geoms), 3)), np.tile(np.eye(3).ravel(), (len(self.geoms), 1))
        free = {kind: [g for g, (other, _) in enumerate(self.geoms) if other == kind] for kind in ("box", "cylinder")}
        for solid in view.solids:
            g = free[solid.kind].pop(0)
            size[g] = solid.half if solid.kind == "box" else [solid.half[0], solid.half[2], 0]
            position[g], turn[g] = solid.position, rotation(*solid.quaternion).ravel()
            color[g] = [*solid.color, 1]
        robot_from_opengl = np.linalg.inv(opengl_from_robot(view))
        return (size, color, position, turn), robot_from_opengl[:3, 3], robot_from_opengl[:3, :3].ravel()

    def render(self, number):
        scene, place, turn = self.prepared[number]
        if self.scene != number // 2:
            self.scene = number // 2
            model, data = self.model, self.data
            model.geom_size[:], model.geom_rgba[:], data.geom_xpos[:], data.geom_xmat[:] = scene
        self.data.cam_xpos[0], self.data.cam_xmat[0] = place, turn
        self.renderer.update_scene(self.data, camera=0)
        return self.renderer.render()


RENDERERS = {"PyBullet": PyBullet, "PyBullet EGL": PyBulletEgl, "MuJoCo EGL": MuJoCo}


def encoded(image, level):
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=level)
    return file.getvalue()


def store(path, pngs):
    """Stores the images only, which is less than a row of flowservo."""
    images = pa.array([{"bytes": png, "path": None} for png in pngs], pa.struct([("bytes", pa.binary()), ("path", pa.string())]))
    table = pa.table({"index": pa.array(range(len(pngs))), "image": images})
    pq.write_table(table, path, row_group_size=256, compression="none", use_dictionary=False, write_statistics=False)
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def measure(renderer, numbers, path):
    """Returns the seconds to render, to encode at each level, and to store."""
    seconds = dict.fromkeys(["render", *(f"png{level}" for level in PNG_LEVELS)], 0.0)
    pngs = []
    for number in numbers:
        start = time.perf_counter()
        image = renderer.render(number)
        seconds["render"] += time.perf_counter() - start
        for level in PNG_LEVELS:
            start = time.perf_counter()
            png = encoded(image, level)
            seconds[f"png{level}"] += time.perf_counter() - start
        pngs.append(png)
    start = time.perf_counter()
    store(path, pngs)
    return seconds | dict(store=time.perf_counter() - start)


def main():
    name, folder, part, parts, *multisamples = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Output of the simulators goes to standard error.
    views = views_of(folder)
    renderer = RENDERERS[name](views, *map(int, multisamples))
    rows = len(views) // 2
    first, last = (rows * (int(part) + i) // int(parts) for i in (0, 1))
    for number in range(min(4, len(views))):
        renderer.render(number)  # Compiles the shaders.
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "images":
            for number in range(int(rest[0])):
                Image.fromarray(renderer.render(number)).save(f"{folder}/{name}-{number}.png")
            answer = {}
        else:
            answer = measure(renderer, range(2 * first, 2 * last), f"{folder}/{name}-{part}.parquet")
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
