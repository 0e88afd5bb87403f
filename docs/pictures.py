"""The pictures of the README: a scan and its replica from the same camera, wiped over one another (WebP) or side by side (JPEG), from
above or at eye level; and a desk that a model furnishes six times (JPEG). And one of docs/navigation.md: walks of agents of a lake, one
that succeeds and one that fails (JPEG).

python docs/pictures.py demo/lake demo/scene0001_00 docs/replica.webp
python docs/pictures.py hard-room 0 docs/hard_room.jpg
python docs/pictures.py wild-rooms 0,1,2,3,4,5 docs/wild_rooms.jpg
python docs/pictures.py eyes:lake rgbd/dining docs/dining.jpg
python docs/pictures.py desk 0 docs/desk.jpg
python docs/pictures.py walks demo/lake docs/walk.jpg
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

from desks import six_desks
from eye_level import eye_level_pair, eye_level_sheet, sheet
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from bench.dwellings import DwellingJob, DwellingsBench, measure_room
from flows.outputs.films import shown_walks
from flows.stats.scenes import picture_scene_of, walk_strip_of
from tasks.films.frames import OUTCOMES
from tasks.stats.scenes import PictureConfig
from warehouse.lake import Lake

LOOK = PictureConfig(width=1050, height=600, jpeg_quality=95)
MARGIN_PX = 105  # cut off on the left and on the right: rooms are about as high as wide
STEPS = 24  # pictures of one sweep
STEP_MS, REST_MS = 60, 1500
INK, PAPER = (38, 42, 51), (255, 255, 255)


def moving_picture(scan: Image.Image, replica: Image.Image) -> bytes:
    """A WebP of a line that sweeps from right to left and back: the scan on its left, the replica on its right."""
    shares = [step / STEPS for step in range(STEPS + 1)]
    sweep = [round(scan.width * (1 - (3 - 2 * share) * share**2)) for share in shares]
    places = sweep + sweep[-2:0:-1]
    first, *rest = (wiped(scan, replica, place) for place in places)
    times = [REST_MS if place in (0, scan.width) else STEP_MS for place in places]
    file = io.BytesIO()
    first.save(file, "WEBP", save_all=True, append_images=rest, duration=times, quality=80, method=6, minimize_size=True)
    return file.getvalue()


def wiped(scan: Image.Image, replica: Image.Image, place: int) -> Image.Image:
    """The scan left of column `place` [px], the replica right of it, and a line between."""
    image = replica.copy()
    image.paste(scan.crop((0, 0, place, scan.height)), (0, 0))
    draw = ImageDraw.Draw(image)
    draw.rectangle((place - 3, 0, place + 2, image.height), fill=INK)
    draw.rectangle((place - 1, 0, place, image.height), fill=PAPER)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 22)
    labels = (("scan", 16, place > 100), ("replica", image.width - 120, place < image.width - 140))
    for text, left, is_shown in labels:
        if is_shown:
            right = left + 24 + draw.textlength(text, font=font)
            draw.rounded_rectangle((left, 16, right, 54), 8, fill=INK)
            draw.text((left + 12, 35), text, font=font, fill=PAPER, anchor="lm")
    return image


def side_by_side(scan: Image.Image, replica: Image.Image) -> bytes:
    """A JPEG of both."""
    image = Image.new("RGB", (scan.width + replica.width + 20, scan.height), PAPER)
    image.paste(scan, (0, 0))
    image.paste(replica, (scan.width + 20, 0))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=85, optimize=True)
    return file.getvalue()


def main() -> None:
    """Write the picture of a scene of a lake, of a room of `metascenes bench rooms`, by number, of a desk, by seed, or of walks; of several
    scenes or rooms at eye level."""
    address, scene, out = sys.argv[1:]
    if address.startswith("eyes:"):
        Path(out).write_bytes(eye_level_sheet(Lake.open(address.removeprefix("eyes:")), scene.split(",")))
        return
    if address == "wild-rooms":
        Path(out).write_bytes(sheet([wild_pair(int(number)) for number in scene.split(",")]))
        return
    if address == "walks":
        Path(out).write_bytes(two_walks(scene))
        return
    if address not in ("hard-room", "desk"):
        draw(address, scene, out)
        return
    with tempfile.TemporaryDirectory() as place:
        if address == "desk":
            Path(out).write_bytes(six_desks(int(scene), place))
            return
        figures = measure_room(DwellingJob(int(scene), 0, place))
        if figures["error"] is not None:
            raise SystemExit(f"room {scene}: {figures['stage']}: {figures['error']}")
        draw(f"{place}/lake", f"scannet/scene{int(scene):04d}_00", out)


def wild_pair(number: int) -> tuple[str, Image.Image, Image.Image]:
    """Name, scan and replica of a wild room at eye level."""
    bench = DwellingsBench(number + 1, 0, 1, kind="wild")
    with tempfile.TemporaryDirectory() as place:
        figures = measure_room(DwellingJob(number, 0, place, settings=bench.all_settings, kind="wild"))
        if figures["error"] is not None:
            raise SystemExit(f"room {number}: {figures['stage']}: {figures['error']}")
        return f"wild room {number}", *eye_level_pair(Lake.open(f"{place}/lake"), f"scannet/scene{number:04d}_00")


def two_walks(address: str) -> bytes:
    """A JPEG of stills of a success of the expert and of a failure of the random policy, as the report shows them."""
    lake = Lake.open(address)
    reader = lake.snapshot()
    wanted = "(policy, success) IN (('expert', true), ('random', false))"
    with reader.connect() as connection:
        rows = connection.sql(shown_walks(1, wanted)).to_arrow_table().to_pylist()
    strips = [walk_strip_of(lake, reader.snapshot_id, row) for row in rows]
    images = [Image.open(io.BytesIO(strip.picture)).convert("RGB") for strip in strips]
    line, gap = 30, 14
    sheet = Image.new("RGB", (images[0].width, sum(image.height + line for image in images) + gap), PAPER)
    brush, top = ImageDraw.Draw(sheet), 0
    font, bold = (ImageFont.truetype(font_manager.findfont(name), 15) for name in ("DejaVu Sans", "DejaVu Sans:bold"))
    for strip, image in zip(strips, images, strict=True):
        chip = brush.textlength(strip.outcome, bold) + 20
        brush.rounded_rectangle((0, top + 2, chip, top + 24), 5, OUTCOMES[strip.outcome])
        brush.text((chip / 2, top + 13), strip.outcome, PAPER, bold, "mm")
        words = f"{strip.policy}, {strip.run_name}: go to the {strip.category}; {strip.ending}"
        brush.text((chip + 10, top + 13), words, INK, font, "lm")
        sheet.paste(image, (0, top + line))
        top += line + image.height + gap
    file = io.BytesIO()
    sheet.save(file, "JPEG", quality=85, optimize=True)
    return file.getvalue()


def draw(address: str, scene_id: str, out: str) -> None:
    """Write the picture of a scene of a lake."""
    lake = Lake.open(address)
    pictures = picture_scene_of(lake, lake.snapshot().snapshot_id, scene_id, LOOK)
    pair = [Image.open(io.BytesIO(data)).convert("RGB") for data in (pictures.corner_scan, pictures.corner_replica)]
    scan, replica = (image.crop((MARGIN_PX, 0, image.width - MARGIN_PX, image.height)) for image in pair)
    Path(out).write_bytes(side_by_side(scan, replica) if out.endswith(".jpg") else moving_picture(scan, replica))


if __name__ == "__main__":
    main()
