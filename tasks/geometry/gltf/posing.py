"""Nodes of a plain GLB: instances as nodes, skins in the pose of their joints, morph targets by their weights."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tasks.geometry.gltf.arrays import Arrays, Floats, natural
from tasks.geometry.gltf.features import INSTANCING, Document, drawn_nodes, entries, extension_of
from tasks.geometry.transforms import pose_from_quaternion_wxyz

_MOVES = ("matrix", "translation", "rotation", "scale")


@dataclasses.dataclass(frozen=True)
class PosedMesh:
    """A mesh as a node shows it. weights: of its morph targets. skin: the skin that moves it, or None."""

    mesh: int
    weights: tuple[float, ...] = ()
    skin: int | None = None


@dataclasses.dataclass(frozen=True)
class Tree:
    """Nodes of the new document. roots: those of the scene. shapes: what each node shows, by its number."""

    nodes: list[dict[str, Any]]
    roots: list[int]
    shapes: dict[int, PosedMesh]


def plain_tree(document: Document, arrays: Arrays) -> Tree:
    """The nodes of the scene, with one node for each instance, and skinned meshes at the root."""
    nodes, meshes, drawn = entries(document, "nodes"), entries(document, "meshes"), drawn_nodes(document)
    numbers = {old: new for new, old in enumerate(drawn)}
    made: list[dict[str, Any]] = []
    for old in drawn:
        node = {key: nodes[old][key] for key in ("name", "extras", *_MOVES) if key in nodes[old]}
        children = [numbers[child] for child in nodes[old].get("children", []) if child in numbers]
        made.append(node | ({"children": children} if children else {}))
    scene = entries(document, "scenes")[document.get("scene", 0)]
    tree = Tree(made, [numbers[root] for root in scene.get("nodes", []) if root in numbers], {})
    for old in drawn:
        if "mesh" in nodes[old]:
            number = natural(nodes[old]["mesh"])
            weights = tuple(float(w) for w in nodes[old].get("weights", meshes[number].get("weights", ())))
            shape = PosedMesh(number, weights if any(weights) else ())
            name = nodes[old].get("name") or meshes[number].get("name")
            _place(tree, numbers[old], nodes[old], shape, name, arrays)
    return tree


def _place(tree: Tree, number: int, node: Document, shape: PosedMesh, name: Any, arrays: Arrays) -> None:
    """Let a node show a shape: by itself, by its instances, or as a skinned mesh at the root."""
    named = {"name": str(name)} if name else {}
    if "skin" in node:
        # The pose of a skinned mesh is that of its joints alone (glTF 2.0, 3.7.3.3).
        tree.nodes[number].pop("name", None)
        tree.nodes.append(dict(named))
        tree.roots.append(len(tree.nodes) - 1)
        tree.shapes[len(tree.nodes) - 1] = dataclasses.replace(shape, skin=natural(node["skin"]))
        return
    attributes = extension_of(node, INSTANCING).get("attributes")
    moves = _moves(attributes, arrays) if isinstance(attributes, dict) else None
    if moves is None:
        tree.nodes[number] |= named
        tree.shapes[number] = shape
        return
    children = tree.nodes[number].setdefault("children", [])
    for index, move in enumerate(moves):
        tree.nodes.append(({"name": instance_name(str(name), index)} if name else {}) | move)
        children.append(len(tree.nodes) - 1)
        tree.shapes[len(tree.nodes) - 1] = shape


def instance_name(name: str, index: int) -> str:
    """Name of an instance: the number belongs to the model, not to the category or the part behind its bars."""
    model, bar, rest = name.partition("|")
    return f"{model}_{index}{bar}{rest}"


def _moves(attributes: Document, arrays: Arrays) -> list[dict[str, Any]] | None:
    """Translation, rotation and scale of each instance; None for instances without any.

    Raises:
        ValueError: they are not as many of each.
    """
    columns = {key.lower(): arrays.numbers(natural(attributes[key])) for key in ("TRANSLATION", "ROTATION", "SCALE") if key in attributes}
    widths = {"translation": 3, "rotation": 4, "scale": 3}
    if not columns:
        return None
    count = len(next(iter(columns.values())))
    if any(values.shape != (count, widths[key]) for key, values in columns.items()):
        raise ValueError(f"{INSTANCING} has attributes of different lengths")
    if "rotation" in columns:
        lengths = np.linalg.norm(columns["rotation"], axis=1, keepdims=True)
        columns["rotation"] = columns["rotation"] / np.where(lengths > 0, lengths, 1.0)
    return [{key: values[index].tolist() for key, values in columns.items()} for index in range(count)]


def morphed(values: Floats, targets: list[Any], attribute: str, weights: tuple[float, ...], arrays: Arrays) -> Floats:
    """An attribute of a primitive with its morph targets, shape (n, width)."""
    for weight, target in zip(weights, targets, strict=False):
        if weight and isinstance(target, dict) and attribute in target:
            values = values + weight * arrays.numbers(natural(target[attribute]))
    return values


def skinned(positions: Floats, attributes: dict[str, Floats], joints: Floats) -> Floats:
    """Positions of a primitive, moved by its joints, shape (n, 3).

    Args:
        positions: at rest, shape (n, 3).
        attributes: `JOINTS_n` and `WEIGHTS_n` as numbers, shape (n, 4) each.
        joints: pose of each joint times its inverse bind matrix, shape (k, 4, 4).

    Raises:
        ValueError: a vertex names a joint that does not exist, or has no weights.
    """
    blended = np.zeros((len(positions), 4, 4))
    total = np.zeros(len(positions))
    for number in range(len(attributes)):
        if f"JOINTS_{number}" not in attributes or f"WEIGHTS_{number}" not in attributes:
            break
        which, weights = attributes[f"JOINTS_{number}"].astype(np.int64), attributes[f"WEIGHTS_{number}"]
        if which.shape != weights.shape or which.shape != (len(positions), 4):
            raise ValueError("JOINTS and WEIGHTS do not fit the positions")
        which = np.where(weights > 0, which, 0)
        if len(which) and (which.min() < 0 or which.max() >= len(joints)):
            raise ValueError("a vertex names a joint that does not exist")
        for column in range(4):
            blended += weights[:, column, None, None] * joints[which[:, column]]
        total += weights.sum(axis=1)
    if len(total) and total.min() <= 0:
        raise ValueError("a vertex of a skinned mesh has no weights")
    moved = np.einsum("nij,nj->ni", blended, np.column_stack([positions, np.ones(len(positions))]))
    result: Floats = moved[:, :3] / total[:, None]
    return result


def joint_poses(document: Document, skin: int, arrays: Arrays) -> Floats:
    """Pose of each joint of a skin in the scene times its inverse bind matrix, shape (k, 4, 4)."""
    stated, poses = entries(document, "skins")[skin], _world_poses(document)
    joints = [natural(joint) for joint in stated["joints"]]
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in stated:
        inverse = arrays.numbers(natural(stated["inverseBindMatrices"]))[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    result: Floats = np.array([poses[joint] for joint in joints]) @ inverse
    return result


def _world_poses(document: Document) -> dict[int, Floats]:
    """Pose of every node in the frame of the scene, 4x4, by its number; also of nodes outside of it."""
    nodes = entries(document, "nodes")
    parents = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
    poses: dict[int, Floats] = {}
    for index in range(len(nodes)):
        path = [index]
        while path[-1] not in poses and path[-1] in parents and len(path) <= len(nodes):
            path.append(parents[path[-1]])
        pose = poses.get(path[-1])
        for number in reversed(path if pose is None else path[:-1]):
            pose = local_pose(nodes[number]) if pose is None else pose @ local_pose(nodes[number])
            poses[number] = pose
    return poses


def local_pose(node: Document) -> Floats:
    """Pose of a node in the frame of the node above it, 4x4."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = (float(value) for value in node.get("rotation", [0, 0, 0, 1]))
    pose = pose_from_quaternion_wxyz([w, x, y, z], node.get("translation", [0, 0, 0]))
    result: Floats = pose @ np.diag([*(float(value) for value in node.get("scale", [1, 1, 1])), 1.0])
    return result
