"""The nodes of a glTF as a tree: whether they make one, which are at its top, and which show anything."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

from tasks.exports.findings import Finding

Document = dict[str, Any]


def listed(document: Document, name: str) -> list[Document]:
    """Objects of one kind."""
    return list(document.get(name, []))


def tree(file: str, document: Document, binary: bytes) -> Iterator[Finding]:
    """Nodes that make no tree."""
    nodes = listed(document, "nodes")
    count = Counter(child for node in nodes for child in node.get("children", []))
    for child, parents in sorted(count.items()):
        if parents > 1:
            yield Finding("tree", f"{file} node {nodes[child].get('name', child)}", f"has {parents} parents")
    roots = roots_of(document)
    for root, times in sorted(Counter(roots).items()):
        if count[root] or times > 1:
            yield Finding("tree", f"{file} node {nodes[root].get('name', root)}", "is at the top of the scene, but not only there")
    reached, queue = set(), list(roots)
    while queue:
        node = queue.pop()
        if node not in reached:
            reached.add(node)
            queue += nodes[node].get("children", [])
    above = _above(document)
    lost = [node for node in range(len(nodes)) if node not in reached and count[node]][:1]
    at: set[int] = set()
    while lost and lost[0] not in at:  # up from a node that is not reached: to a root that no scene has, or in a circle
        at.add(lost[0])
        lost = above[lost[0]][:1]
    if lost:
        yield Finding("tree", f"{file} node {nodes[lost[0]].get('name', lost[0])}", "lies below itself")
    if not roots:
        yield Finding("tree", f"{file} scene", "has no nodes")


def roots_of(document: Document) -> list[int]:
    """Nodes at the top of the scene that is shown."""
    scenes = listed(document, "scenes")
    return list(scenes[document.get("scene", 0)].get("nodes", []))


def _above(document: Document) -> dict[int, list[int]]:
    """Nodes that have a node as their child, by that node."""
    parents: dict[int, list[int]] = defaultdict(list)
    for i, node in enumerate(listed(document, "nodes")):
        for child in node.get("children", []):
            parents[child].append(i)
    return parents


def seen_of(document: Document) -> set[int]:
    """Nodes that have a mesh, or one below them has."""
    above, seen = _above(document), set[int]()
    queue = [i for i, node in enumerate(listed(document, "nodes")) if "mesh" in node]
    while queue:
        node = queue.pop()
        if node not in seen:
            seen.add(node)
            queue += above.get(node, [])
    return seen
