"""The process that decodes compressed meshes and textures: native decoders meet foreign bytes in it alone.

It reads `jobs.json` and `data.bin` in the folder that its arguments name. It leaves `decoded.bin` and its facts: for each job the
arrays with dtype, shape and offset, or the problem.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import numpy as np

from schemas.budget import BUDGET
from schemas.parsing import json_value
from tasks.confinement import leave, limit

JOBS, DATA, DECODED = "jobs.json", "data.bin", "decoded.bin"


def main() -> None:
    """Decode every job in the folder that the arguments name."""
    folder, written = Path(sys.argv[1]), int(sys.argv[2])
    limit(int(sys.argv[3]), int(sys.argv[4]), written)
    jobs, data = json_value((folder / JOBS).read_bytes()), (folder / DATA).read_bytes()
    facts: list[dict[str, Any]] = []
    with (folder / DECODED).open("wb") as file:
        for job in jobs:
            source = data[job["start"] : job["end"]]
            try:
                arrays = {"draco": _draco, "meshopt": _meshopt, "basis": _basis}[job["kind"]](source, job)
            except MemoryError:
                raise
            except Exception as error:  # decoders raise whatever the bytes lead them to
                facts.append({"problem": f"{type(error).__name__}: {error}"[:200]})
                continue
            stated = {}
            for name, array in arrays.items():
                stated[name] = [np.ascontiguousarray(array).dtype.str, list(array.shape), file.tell()]
                file.write(np.ascontiguousarray(array).tobytes())
            facts.append({"arrays": stated})
    leave(folder, {"jobs": facts})


def _draco(source: bytes, job: dict[str, Any]) -> dict[str, Any]:
    """Faces, shape (m, 3), and the attributes by their Draco ids, shape (n, width)."""
    import DracoPy

    mesh = DracoPy.decode(source)
    faces = getattr(mesh, "faces", None)
    if faces is None:
        raise ValueError("holds points without triangles")
    arrays = {"faces": np.asarray(faces, dtype="<u4").reshape(-1, 3)}
    for attribute in mesh.attributes:
        values = np.asarray(attribute["data"])
        values = values.reshape(len(values), -1)
        arrays[str(attribute["unique_id"])] = values.astype("<f4") if values.dtype.kind == "f" else values
    return arrays


def _meshopt(source: bytes, job: dict[str, Any]) -> dict[str, Any]:
    """Contents of a view."""
    import meshopt

    rows = meshopt.decode_gltf_buffer(source, job["count"], job["stride"], job["mode"], job["filter"])
    return {"view": np.asarray(rows).view(np.uint8).reshape(-1)}


def _basis(source: bytes, job: dict[str, Any]) -> dict[str, Any]:
    """The image as the bytes of a PNG file."""
    import opengl_basisu
    from PIL import Image

    texture = opengl_basisu.open(source)
    if texture.width * texture.height > BUDGET.pixels:
        raise ValueError(f"is {texture.width} x {texture.height} pixels, more than {BUDGET.pixels}")
    pixels = np.asarray(texture.transcode("rgba8").data)
    if texture.y_flipped:
        pixels = pixels[::-1]
    packed = io.BytesIO()
    Image.fromarray(pixels if texture.has_alpha else np.ascontiguousarray(pixels[:, :, :3])).save(packed, "PNG", compress_level=1)
    return {"png": np.frombuffer(packed.getvalue(), dtype=np.uint8)}


if __name__ == "__main__":
    main()
