"""Frames of a video as images: what the child does that decodes it."""

from __future__ import annotations

import sys
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file
from tasks.confinement import answer, limit

MAX_SIDE_PX = 960
"""Longer side of the images: views are crops of 256 pixels, and depth has 256."""

QUALITY = 92
"""Quality of JPEGs: finer than the video itself."""

CODE = "from tasks.capture.files.video import main; main()"


def main() -> None:
    """Write every so many frames up to the last one with depth as JPEGs, called by their numbers."""
    path, folder, step, last = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    limit(int(sys.argv[5]), int(sys.argv[6]))
    answer(folder, lambda: _decode(path, folder, step, last), "copy the video again")


def _decode(path: Path, folder: Path, step: int, last: int) -> dict[str, int]:
    """Number of decoded frames, and the size of the video [px]."""
    import av

    written, count = 0, 0
    # A file object gives the demuxer no path to open anything else by.
    with open_file(path, path.name, BUDGET.scene_bytes) as file, av.open(file, "r", format="mp4") as container:
        if not container.streams.video:
            raise InputError(path.name, "streams", "has no video", "copy the video again")
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1
        width, height = stream.codec_context.width, stream.codec_context.height
        if not 0 < width * height <= BUDGET.pixels:
            raise InputError(path.name, "size", f"is {width} x {height} pixels", f"shrink it below {BUDGET.pixels} pixels")
        for frame in container.decode(stream):
            if count > last:
                break
            if frame.width * frame.height > BUDGET.pixels:
                raise InputError(path.name, "size", f"is {frame.width} x {frame.height} pixels", "copy the video again")
            if count % step == 0:
                image = frame.to_image()
                image.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
                target = folder / f"{count:06d}.jpg"
                image.save(target, "JPEG", quality=QUALITY)
                written += target.stat().st_size
                if written > BUDGET.scene_bytes:
                    raise InputError(path.name, "frames", f"take more than {BUDGET.scene_bytes >> 20} MB", "cut the video")
            count += 1
        return {"count": count, "stated": int(stream.frames), "width": width, "height": height}
