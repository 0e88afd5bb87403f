"""Changes to files: by what they are (JSON, GLB, XML, tables of numbers, images, archives), and to their bytes."""

from __future__ import annotations

import gzip
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from random import Random

from tests.fuzzing.cases import Case, Odd
from tests.fuzzing.documents import DEPTH, changed_json, near, number, word

Change = Callable[[bytes, Random], bytes]

LARGEST = 8 * 2**20
"""A change that makes a file larger than so many bytes is not made: what is looked for are small files that ask for much."""

_INTEGERS = (0, 1, 2, 3, 7, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**40, 2**63 - 1, 2**64 - 1)
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-30, 1e30, 3e38, float("inf"), float("-inf"), float("nan"))


def changed(case: Case, others: Sequence[Case], plan: Sequence[int]) -> dict[str, bytes | Odd]:
    """A case with one change for every number of `plan`; `others` are what parts can come from."""
    found = dict(case)
    for one in plan:
        random = Random(one)
        name = random.choice(sorted(found)) if found else ""
        if not name:
            break
        if random.random() < (0.06 if len(found) > 1 else 0.01):
            _change_folder(found, name, random)
            continue
        content = found[name]
        if isinstance(content, Odd):
            continue
        after = changed_file(name, content, random, [other[name] for other in others if isinstance(other.get(name), bytes)])  # type: ignore[misc]
        if len(after) <= max(LARGEST, len(content)):
            found[name] = after
    return found


def changed_file(name: str, data: bytes, random: Random, others: Sequence[bytes] = ()) -> bytes:
    """A file with one change."""
    own = next((change for is_kind, change in _KINDS if is_kind(name, data)), None)
    if own is not None and random.random() < 0.8:
        return own(data, random)
    return _changed_bytes(data, random, others)


def _change_folder(found: dict[str, bytes | Odd], name: str, random: Random) -> None:
    """Change what lies where in a case."""
    other = random.choice(sorted(found))
    match random.randrange(11):
        case 0 | 1:
            del found[name]
        case 2:
            found[name] = b""
        case 3:
            found[name], found[other] = found[other], found[name]
        case 4:
            found[name] = Odd("folder")
        case 5:
            found[name] = Odd(
                "link", random.choice(["/dev/zero", "/etc/passwd", "..", ".", name.rpartition("/")[2], "nowhere", "/proc/self/mem"])
            )
        case 6:
            found[name] = Odd("fifo")
        case 7:
            found[name] = Odd("sparse", str(random.choice([0, 1, 2**31, 2**33, 2**40])))
        case 8:
            head, _, tail = name.rpartition("/")
            stem, dot, ending = tail.rpartition(".")
            renamed = random.choice(
                [f"{tail}.bak", f"é{tail}", tail.upper(), f"{'9' * 30}{dot}{ending}", f"{stem}٣{dot}{ending}", f"-{tail}", f"{stem}"]
            )
            found[f"{head}/{renamed}" if head else renamed] = found.pop(name)
        case 9:
            found[f"{name.rpartition('/')[0]}/copy_{name.rpartition('/')[2]}".lstrip("/")] = found[name]
        case 10:
            found[name] = random.choice(
                [b"\0" * 4096, b"\xff" * 64, b"[" * DEPTH, b"{}", b"null", b"0", b"\xef\xbb\xbf", b"ply\n", b"glTF"]
            )


def _changed_bytes(data: bytes, random: Random, others: Sequence[bytes] = ()) -> bytes:
    """Bytes changed without a thought of what they mean. The beginning, where headers are, is met more often."""
    if not data:
        return bytes(random.getrandbits(8) for _ in range(random.choice([1, 4, 100])))
    reach = len(data) if random.random() < 0.5 else min(len(data), 256)
    at = random.randrange(reach)
    match random.randrange(9):
        case 0:
            return data[:at]
        case 1:
            return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]
        case 2 | 3:
            value = _word_bytes(random)
            return data[:at] + value + data[at + len(value) :]
        case 4:
            return data[:at] + _word_bytes(random) + data[at:]
        case 5:
            return data[:at] + data[at + random.choice([1, 2, 4, 16, 1024]) :]
        case 6:
            end = min(len(data), at + random.choice([1, 8, 100, 4096]))
            return data[:end] + data[at:end] * random.choice([1, 2, 50]) + data[end:]
        case 7:
            other = random.choice(others) if others else data
            return data[:at] + other[random.randrange(len(other) + 1) :]
        case _:
            count = random.choice([1, 4, 16, 256])
            return data[:at] + random.choice([b"\0", b"\xff", b" ", b"A"]) * count + data[at + count :]


def _word_bytes(random: Random) -> bytes:
    """An integer or a float as files hold them."""
    order = random.choice("<>")
    if random.random() < 0.25:
        kind = random.choice("fd")
        value = random.choice(_FLOATS)
        return struct.pack(order + kind, value)
    kind, bits = random.choice([("B", 8), ("H", 16), ("I", 32), ("Q", 64)])
    value = (random.choice(_INTEGERS) + random.choice([0, 0, 1, -1])) % (1 << bits)
    return struct.pack(order + kind, value)


def _changed_lines(data: bytes, random: Random) -> bytes:
    """JSON Lines with one line changed, or lines moved."""
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    match random.randrange(6):
        case 0:
            lines.insert(random.randrange(len(lines) + 1), lines[at])
        case 1:
            del lines[at]
        case _:
            lines[at] = changed_json(lines[at], random)
    return b"\n".join(lines)


def _changed_glb(data: bytes, random: Random) -> bytes:
    """A GLB with its document, its buffer, or its lengths changed."""
    chunks, offset = [], 12
    while offset + 8 <= len(data) and len(chunks) < 8:
        size, kind = struct.unpack_from("<II", data, offset)
        chunks.append([kind, data[offset + 8 : offset + 8 + size]])
        offset += 8 + size
    if not chunks:
        return _changed_bytes(data, random)
    choice = random.random()
    if choice < 0.75:
        text = changed_json(chunks[0][1], random)
        chunks[0][1] = text + b" " * (-len(text) % 4)
    elif choice < 0.92 and len(chunks) > 1:
        chunks[1][1] = _changed_bytes(chunks[1][1], random)
    else:
        random.shuffle(chunks) if random.random() < 0.3 else chunks.append(list(random.choice(chunks)))
    body = b"".join(struct.pack("<II", len(content), kind) + content for kind, content in chunks)
    return struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body


_BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaaaaaaaaaaaa">' + "".join(
    f'<!ENTITY {after} "{f"&{before};" * 12}">' for before, after in zip("abcdefgh", "bcdefghi", strict=True)
) + "]>"  # fmt: skip
_OUTSIDE = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
_ELEMENT = re.compile(rb"<([A-Za-z_][\w.:-]*)(?:\s[^<>]*)?(?:/>|>)")
_ATTRIBUTE = re.compile(rb"([\w.:-]+)\s*=\s*\"([^\"]*)\"")


def _changed_xml(data: bytes, random: Random) -> bytes:
    """XML with an attribute, an element or its head changed."""
    attributes, elements = list(_ATTRIBUTE.finditer(data)), list(_ELEMENT.finditer(data))
    choice = random.random()
    if attributes and choice < 0.6:
        found = random.choice(attributes)
        return data[: found.start(2)] + _attribute(found[2].decode("utf-8", "replace"), random) + data[found.end(2) :]
    if attributes and choice < 0.68:
        found = random.choice(attributes)
        return data[: found.start()] + (b"" if random.random() < 0.5 else word(random).encode() + b'="1"') + data[found.end() :]
    if not elements:
        return _changed_bytes(data, random)
    found = random.choice(elements)
    name = found[1]
    end = found.end() if found[0].endswith(b"/>") else data.find(b"</" + name + b">", found.end()) + len(name) + 3
    if end <= found.end() and not found[0].endswith(b"/>"):
        return _changed_bytes(data, random)
    whole = data[found.start() : end]
    match random.randrange(7):
        case 0:
            return data[: found.start()] + data[end:]
        case 1 | 2:
            return data[:end] + whole * random.choice([1, 2, 30]) + data[end:]
        case 3:
            levels = random.choice([10, 2000, 20_000])
            return (
                data[: found.start()]
                + b"<"
                + name
                + b">" * 1
                + (b"<" + name + b">") * levels
                + (b"</" + name + b">") * (levels + 1)
                + data[end:]
            )
        case 4:
            other = random.choice(elements)
            return data[: other.start()] + whole + data[other.start() :]
        case 5:
            inside, bomb = random.choice([("&i;", _BOMB), ("&x;", _OUTSIDE)])
            text = data.decode("utf-8", "replace")
            start = text.find("<", text.find("?>") + 1 if "?>" in text else 0)
            return (text[:start] + bomb + re.sub(r">", f">{inside}", text[start:], count=1)).encode()
        case _:
            replicate = random.choice(["1000000", "1e9", "-1", "50"])
            return data[: found.start()] + f'<replicate count="{replicate}" offset="0 0 1">'.encode() + whole + b"</replicate>" + data[end:]


def _attribute(value: str, random: Random) -> bytes:
    words = value.split()
    if words and random.random() < 0.6:
        at = random.randrange(len(words))
        match random.randrange(4):
            case 0:
                del words[at]
            case 1:
                words.append(words[at])
            case 2:
                words[at] = _near(words[at].encode(), random)
            case _:
                words[at] = number(random)
        value = " ".join(words)
    else:
        value = word(random) if random.random() < 0.7 else number(random)
    return re.sub(r"[\"<&\x00-\x08\x0b-\x1f]", lambda match: random.choice(["", "&#65;", match[0]]), value).encode("utf-8", "replace")


def _near(text: bytes, random: Random) -> str:
    """A word like another, a number like a number."""
    told = text.decode("utf-8", "replace")
    try:
        return str(near(float(told) if re.search("[.eE]", told) else int(told), random))
    except ValueError:
        return str(near(told, random))


_TOKEN = re.compile(rb"[^\s,]+")


def _changed_text(data: bytes, random: Random) -> bytes:
    """Text with a word or a line changed."""
    if random.random() < 0.7:
        start = random.randrange(max(1, len(data)))
        if random.random() < 0.5:
            start = min(start, 400)
        found = _TOKEN.search(data, start) or _TOKEN.search(data)
        if found is None:
            return _changed_bytes(data, random)
        new = _near(found[0], random) if random.random() < 0.3 else number(random) if random.random() < 0.7 else word(random)
        return data[: found.start()] + new.encode("utf-8", "replace") + data[found.end() :]
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    if random.random() < 0.5:
        at = min(at, random.randrange(12))
    match random.randrange(6):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[at])
        case 2:
            other = random.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            lines[at] += b" " + number(random).encode()
        case 4:
            lines[at] = lines[at] * random.choice([2, 100])
        case _:
            lines[at] = b" ".join(lines[at].split()[:-1])
    return b"\n".join(lines)


def _changed_ply(data: bytes, random: Random) -> bytes:
    """A PLY with its header or its content changed."""
    end = data.find(b"end_header")
    if end < 0 or random.random() < 0.6:
        return _changed_text(data, random) if b"format ascii" in data[:200] else _changed_bytes(data, random)
    return _changed_text(data[:end], random) + data[end:]


def _changed_png(data: bytes, random: Random) -> bytes:
    """A PNG whose header says something else, with a checksum that fits."""
    if data[12:16] != b"IHDR" or len(data) < 33 or random.random() < 0.4:
        return _changed_bytes(data, random)
    head = bytearray(data[16:29])
    if random.random() < 0.6:
        struct.pack_into(">I", head, random.choice([0, 4]), random.choice([0, 1, 13_000, 65_535, 2**31 - 1, 2**32 - 1]))
    else:
        head[random.randrange(8, 13)] = random.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])
    return data[:16] + bytes(head) + struct.pack(">I", zlib.crc32(b"IHDR" + bytes(head))) + data[33:]


@cache
def _zeros(compress: str, megabytes: int) -> bytes:
    block = b"[" + b" " * (2**20 - 1)
    if compress == "gzip":
        return gzip.compress(block * 64, 9) * (megabytes // 64)
    return zlib.compress(block * megabytes, 9)


def _changed_gzip(data: bytes, random: Random) -> bytes:
    """A gzip file with its content changed, or with gigabytes in a few bytes."""
    if random.random() < 0.08:
        return _zeros("gzip", 6 * 1024)
    if random.random() < 0.2:
        return _changed_bytes(data, random)
    try:
        with gzip.open(io.BytesIO(data)) as file:
            content = file.read(LARGEST + 1)
    except (OSError, EOFError, zlib.error):
        return _changed_bytes(data, random)
    # An earlier change may have put gigabytes in here: to unpack them takes the memory that is meant for the reader.
    return gzip.compress(changed_json(content, random), 1) if len(content) <= LARGEST else _changed_bytes(data, random)


def _members(archive: zipfile.ZipFile) -> list[tuple[str, bytes]]:
    """Names and contents of the members of an archive.

    Raises:
        ValueError: the contents exceed `LARGEST` bytes together.
    """
    members, left = [], LARGEST
    for info in archive.infolist():
        with archive.open(info) as file:
            content = file.read(left + 1)
        left -= len(content)
        if left < 0:
            raise ValueError(f"{info.filename} is too large")
        members.append((info.filename, content))
    return members


def _changed_zip(data: bytes, random: Random) -> bytes:
    """A zip file with a member changed, added or renamed."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = _members(archive)
    except (zipfile.BadZipFile, OSError, EOFError, zlib.error, NotImplementedError, RuntimeError, ValueError):
        return _changed_bytes(data, random)
    if not members or random.random() < 0.3:
        return _changed_bytes(data, random)
    at = random.randrange(len(members))
    name, content = members[at]
    match random.randrange(4):
        case 0:
            members[at] = (f"../../{name}", content)
        case 1:
            members.append((name, content))
        case _:
            members[at] = (name, changed_file(name, content, random))
    out = io.BytesIO()
    kind = random.choice([zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    with zipfile.ZipFile(out, "w", kind) as archive:
        for member, content in members:
            archive.writestr(member, content)
    return out.getvalue()


def _ends(*endings: str) -> Callable[[str, bytes], bool]:
    return lambda name, data: name.lower().endswith(endings)


def _begins(*beginnings: bytes) -> Callable[[str, bytes], bool]:
    return lambda name, data: data.startswith(beginnings)


_KINDS: Sequence[tuple[Callable[[str, bytes], bool], Change]] = (
    (_begins(b"glTF"), _changed_glb),
    (_begins(b"\x89PNG"), _changed_png),
    (_begins(b"\x1f\x8b"), _changed_gzip),
    (_begins(b"PK\x03\x04"), _changed_zip),
    (_begins(b"ply"), _changed_ply),
    (_ends(".jsonl", ".ndjson"), _changed_lines),
    (_ends(".json"), changed_json),
    (_ends(".xml", ".urdf", ".mjcf", ".sdf"), _changed_xml),
    (_ends(".yaml", ".txt", ".log", ".csv", ".tsv", ".toml", ".obj", ".mtl", ".usda", ".md", "LICENSE", ".scn"), _changed_text),
)
"""How a file is changed by what it is, which its first bytes say or else its name."""
