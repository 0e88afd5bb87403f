"""The triangles of marching cubes, case by case, as Shap-E's decoder takes them from its weights: written out, since none are at hand."""

from __future__ import annotations

import numpy as np

EDGES = ((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7))
"""Corners x + 2 y + 4 z at the ends of a cube's edges, in the decoder's order."""

FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Corners of a cube's sides, counterclockwise as seen from outside."""


def triangles() -> tuple[np.ndarray, np.ndarray]:
    """Edges that triangles of each case join, shape (256, 5, 3), and which triangles there are, shape (256, 5). Bits of a case are corners
    that are inside."""
    number = {frozenset(ends): index for index, ends in enumerate(EDGES)}
    cases, masks = np.zeros((256, 5, 3), dtype=np.int64), np.zeros((256, 5), dtype=bool)
    for case in range(256):
        follows: dict[int, int] = {}
        for face in FACES:
            inside = [bool(case >> corner & 1) for corner in face]
            for k in range(4):
                if inside[k] and not inside[(k + 1) % 4]:  # a run of corners that are inside ends here
                    begin = k
                    while inside[begin]:
                        begin = (begin - 1) % 4
                    out, into = number[frozenset((face[k], face[(k + 1) % 4]))], number[frozenset((face[begin], face[(begin + 1) % 4]))]
                    follows[out] = into
        made = 0
        while follows:
            loop = [next(iter(follows))]
            while loop[-1] in follows:
                loop.append(follows.pop(loop[-1]))
            for k in range(1, len(loop) - 2):
                cases[case, made], masks[case, made] = (loop[0], loop[k], loop[k + 1]), True
                made += 1
    return cases, masks
