"""A cart whose wheels touch the floor of the exported MuJoCo scene, among the colliders of that scene."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.parsing import json_value
from tasks.geometry.transforms import pose_from_quaternion_wxyz, quaternion_wxyz
from tasks.robot.bodies import Motors, Readings, Slip
from tasks.robot.configuration import Cart, DriveNoise
from tasks.robot.drive import wheel_speeds
from tasks.robot.floor_map import climbed_m

if TYPE_CHECKING:
    from tasks.exports.bodies import Replica
    from tasks.exports.config import ExportsConfig
    from tasks.robot.displaced import PlanarMotion

Array = NDArray[np.float64]
Element = ElementTree.Element

CART = "cart"
"""Name of the cart's body; those of its wheels begin with it. Instances have numbers for names, and parts of the shell other words."""

WHEEL_KG = 0.3
"""Of a wheel with its tire."""

WHEEL_WIDTH_M = 0.02
"""Of a tire, which is round across, too: it touches the floor at a point, and turns in place without scrubbing."""

GRIP = 0.9
"""Friction of a tire on the floor: rubber on wood."""

CASTER_GAP_M = 0.0002
"""Casters hang this far above the floor [m]: the wheels carry the cart, and it leans on a caster by a tenth of a degree."""

ROTOR_KG_M2 = 0.02
"""Of a motor behind its gear, as the wheel feels it: that of 8 kg at the rim. With a wheel that spins freely MuJoCo takes the friction that
stops its slipping for a small one, and the cart glides ahead of its wheels by 8 cm/s when it brakes."""

GAIN = 3.0
"""Torque of a motor for each rad/s that its wheel is off [N m s]: it follows within a hundredth of a second."""

TORQUE_NM = 3.0
"""The most that a motor turns with: 60 N at the rim, where the cart takes 6 N to get going and a wall stops it all the same."""


def scene_text(replica: Replica, config: ExportsConfig) -> str:
    """The exported MuJoCo scene of a replica without what is only seen: its `scene.xml`, which needs no files then."""
    import trimesh

    from tasks.exports.mjcf import mjcf_files

    def bare(part: trimesh.Trimesh) -> trimesh.Trimesh:
        """Without images, which take seconds to write."""
        return trimesh.Trimesh(part.vertices, part.faces, process=False)

    shapes = {body.shape.name: body.shape for body in replica.bodies}
    plain = {name: dataclasses.replace(shape, parts=[bare(part) for part in shape.parts]) for name, shape in shapes.items()}
    bodies = tuple(dataclasses.replace(body, shape=plain[body.shape.name]) for body in replica.bodies)
    shell = tuple((name, bare(part)) for name, part in replica.shell)
    files = mjcf_files(dataclasses.replace(replica, bodies=bodies, shell=shell), config)
    root = ElementTree.fromstring(next(file.data for file in files if file.role == "scene"))
    _strip(root)
    return ElementTree.tostring(root, encoding="unicode")


def cart_model(scene: str, cart: Cart, motions: Mapping[str, PlanarMotion] | None = None, is_free: bool = False) -> Any:
    """A `mujoco.MjModel` of an exported scene with a cart in it.

    Its bodies are called as on a `Floor`: by instance, and by part of the shell. Doors are open, and the cart does not meet what is no
    higher than it climbs. What is only seen is left out.

    Args:
        scene: `scene.xml` of an exported scene, or of `scene_text`.
        cart: Its shape and mass.
        motions: By instance, what does not stand where the scene has it.
        is_free: Let things be pushed, and fall, as in the exported scene, rather than stand fast; some ten times slower.
    """
    from tasks.optimization.engines.mujoco_engine import mujoco_module

    root = ElementTree.fromstring(scene)
    _strip(root)
    world = root.find("worldbody")
    assert world is not None
    abouts = {text.attrib["name"]: json_value(text.attrib["data"]) for text in root.iterfind("custom/text")}
    meshes = {mesh.attrib["name"]: _numbers(mesh.attrib["vertex"]).reshape(-1, 3) for mesh in root.iterfind("asset/mesh")}
    flat = []
    for body in list(world.iterfind("body")):
        is_there, is_flat = _place(body, abouts.get(body.attrib["name"]), meshes, motions or {}, cart, is_free)
        if not is_there:
            world.remove(body)
        elif is_flat:
            flat.append(body.attrib["name"])
    world.append(_cart(cart))
    contact = ElementTree.SubElement(root, "contact")
    for name in flat:
        for part in (CART, f"{CART}_left", f"{CART}_right"):
            ElementTree.SubElement(contact, "exclude", body1=name, body2=part)
    actuator = ElementTree.SubElement(root, "actuator")
    for side in ("left", "right"):
        ElementTree.SubElement(
            actuator, "velocity", name=f"{CART}_{side}", joint=f"{CART}_{side}", kv=repr(GAIN), forcerange=f"{-TORQUE_NM} {TORQUE_NM}"
        )
    return mujoco_module().MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


class MujocoBody:
    """A cart on wheels in a MuJoCo scene. What goes wrong is drawn as for a `PlanarBody`: the same from the same generator.

    Slip is a wheel that turns as much less as its share says, while its encoder reads what it was to turn. Once the cart touches something,
    its motors hold it.

    model: Of `cart_model`; several carts may take turns with one. pose: Where it starts: x, y [m] and yaw [rad], world frame, shape (3,).
    """

    def __init__(self, model: Any, cart: Cart, noise: DriveNoise, pose: ArrayLike, rng: np.random.Generator) -> None:
        from tasks.optimization.engines.mujoco_engine import mujoco_module

        self._mujoco, self._model, self._cart = mujoco_module(), model, cart
        self._data = self._mujoco.MjData(model)
        slipping, reading = rng.spawn(2)  # as of a planar body
        self._motors, self._slip, self._readings = Motors(cart, noise), Slip(noise, slipping), Readings(noise, reading)
        x, y, self._yaw = (float(value) for value in np.asarray(pose, dtype=np.float64))
        chassis, wheels = model.joint(CART), [model.joint(f"{CART}_{side}") for side in ("left", "right")]
        self._at, self._going = int(chassis.qposadr[0]), int(chassis.dofadr[0])
        self._turning = [int(joint.dofadr[0]) for joint in wheels]
        self._motor = [int(model.actuator(f"{CART}_{side}").id) for side in ("left", "right")]
        self._data.qpos[self._at : self._at + 7] = [x, y, 0.0, math.cos(0.5 * self._yaw), 0.0, 0.0, math.sin(0.5 * self._yaw)]
        names = [model.body(number).name for number in range(model.nbody)]
        self._owners: list[str] = [names[body] for body in model.geom_bodyid]
        self._is_cart = np.array([owner.startswith(CART) for owner in self._owners])
        self._is_floor = model.geom_bodyid == 0
        self.touched: str | None = None

    @property
    def pose(self) -> Array:
        """Where it is: x, y [m] and yaw [rad], world frame, shape (3,). The yaw goes on beyond half a turn."""
        x, y = self._data.qpos[self._at : self._at + 2]
        return np.array([x, y, self._yaw])

    @property
    def speeds(self) -> tuple[float, float]:
        """How fast it really goes: speed along its heading [m/s] and turn rate about +Z [rad/s]."""
        vx, vy, _, _, _, w = (float(value) for value in self._data.qvel[self._going : self._going + 6])
        return vx * math.cos(self._yaw) + vy * math.sin(self._yaw), w

    def drive(self, v: float, w: float) -> None:
        """Command a speed [m/s] and a turn rate [rad/s]."""
        self._motors.drive(v, w)

    def step(self, seconds: float) -> None:
        """Let time pass, in steps that are no longer than the scene's."""
        targets = np.array(wheel_speeds(*self._motors.step(seconds), self._cart)) * self._slip.step(seconds)
        count = math.ceil(seconds / self._model.opt.timestep - 1e-6)
        self._model.opt.timestep = seconds / count
        for _ in range(count):
            self._data.ctrl[self._motor] = 0.0 if self.touched else targets
            self._mujoco.mj_step(self._model, self._data)
            self.touched = self.touched or self._touching()
        w, x, y, z = self._data.qpos[self._at + 3 : self._at + 7]
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        self._yaw += math.remainder(yaw - self._yaw, 2.0 * math.pi)

    def wheel_readings(self) -> tuple[float, float]:
        """What the encoders say: turn rates of the left and the right wheel [rad/s]."""
        left, right = self._data.qvel[self._turning] / self._slip.shares
        return self._readings.wheels(float(left), float(right))

    def gyro_reading(self) -> float:
        """What the gyro says: the turn rate about +Z [rad/s]."""
        return self._readings.gyro(self.speeds[1])

    def _touching(self) -> str | None:
        """What the cart touches beside the floor; of several things that which it is deepest in."""
        pairs = self._data.contact.geom
        mine = self._is_cart[pairs]
        touching = np.flatnonzero((mine.sum(axis=1) == 1) & ~self._is_floor[pairs].any(axis=1) & (self._data.contact.dist <= 0.0))
        if not len(touching):
            return None
        deepest = touching[np.argmin(self._data.contact.dist[touching])]
        first, second = pairs[deepest]
        return self._owners[int(second if self._is_cart[first] else first)]


def _strip(root: Element) -> None:
    """Take out what is only seen, and the state at the start, which does not have the cart."""
    for parent in root.iter():
        for child in list(parent):
            is_seen = child.tag == "geom" and child.get("class") == "visual"
            is_look = child.tag in ("texture", "material", "light", "camera", "keyframe") or (
                child.tag == "mesh" and "file" in child.attrib
            )
            if is_seen or is_look:
                parent.remove(child)


def _place(
    body: Element,
    about: Mapping[str, Any] | None,
    meshes: Mapping[str, Array],
    motions: Mapping[str, PlanarMotion],
    cart: Cart,
    is_free: bool,
) -> tuple[bool, bool]:
    """Whether a body of the scene is in the way at all, and whether the cart drives over it. It gets its name and its place here.
    about: What the scene says of it; of the shell's parts nothing."""
    from tasks.exports.nav2 import is_door

    if about is None:
        body.set("name", body.attrib["name"].removeprefix("room_"))
        return True, False
    if is_door(about["category"]):
        return False, False
    name = str(about["instance_id"])
    body.set("name", name)
    if not is_free:
        for joint in body.findall("freejoint"):
            body.remove(joint)
    pose = pose_from_quaternion_wxyz(_numbers(body.attrib["quat"]).tolist(), _numbers(body.attrib["pos"]))
    if name in motions:
        pose = motions[name].matrix @ pose
        body.set("pos", _words(pose[:3, 3]))
        body.set("quat", _words(quaternion_wxyz(pose)))
    tops = [(meshes[geom.attrib["mesh"]] @ pose[2, :3]).max() + pose[2, 3] for geom in body.iterfind("geom")]
    return True, bool(max(tops, default=0.0) <= climbed_m(about["category"], cart))


def _cart(cart: Cart) -> Element:
    """The cart over the origin, its axle across x: a cylinder, two driven wheels, and casters before and behind, as low as it may be."""
    body = Element("body", name=CART)
    ElementTree.SubElement(body, "freejoint", name=CART)
    mass, height = cart.mass_kg - 2.0 * WHEEL_KG, cart.height_m - cart.climb_m
    across = mass * (3.0 * cart.radius_m**2 + height**2) / 12.0
    inertia = [across, across, 0.5 * mass * cart.radius_m**2]  # of a solid cylinder, whose battery lies at the bottom
    low = min(cart.wheel_radius_m, 0.5 * cart.height_m)
    ElementTree.SubElement(body, "inertial", pos=_words([0.0, 0.0, low]), mass=repr(mass), diaginertia=_words(inertia))
    smooth = {"friction": "0 0 0", "condim": "1", "priority": "1"}
    shape = {"fromto": _words([0.0, 0.0, cart.climb_m, 0.0, 0.0, cart.height_m]), "size": repr(cart.radius_m)}
    ElementTree.SubElement(body, "geom", {"name": CART, "class": "collision", "type": "cylinder", **shape, **smooth})
    radius = max(0.5 * cart.climb_m, 0.005)
    for name, side in (("front", 1.0), ("back", -1.0)):
        place = {"pos": _words([side * 0.7 * cart.radius_m, 0.0, radius + CASTER_GAP_M]), "size": repr(radius)}
        ElementTree.SubElement(body, "geom", {"name": f"{CART}_{name}", "class": "collision", "type": "sphere", **place, **smooth})
    for name, side in (("left", 1.0), ("right", -1.0)):
        wheel = ElementTree.SubElement(
            body, "body", name=f"{CART}_{name}", pos=_words([0.0, side * 0.5 * cart.track_m, cart.wheel_radius_m])
        )  # fmt: skip
        ElementTree.SubElement(wheel, "joint", name=f"{CART}_{name}", type="hinge", axis="0 1 0", armature=repr(ROTOR_KG_M2))
        size = _words([cart.wheel_radius_m, 0.5 * WHEEL_WIDTH_M, cart.wheel_radius_m])
        look = {"type": "ellipsoid", "size": size, "mass": repr(WHEEL_KG), "friction": f"{GRIP} 0 0", "condim": "3", "priority": "1"}
        ElementTree.SubElement(wheel, "geom", {"name": f"{CART}_{name}", "class": "collision", **look})
    return body


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)


def _words(values: ArrayLike) -> str:
    return " ".join(repr(value) for value in np.asarray(values, dtype=np.float64).reshape(-1).tolist())
