"""Changes to JSON that keep it nearly right: values of other kinds, numbers of 400 digits, keys twice, depth, paths that escape."""

from __future__ import annotations

import json
from random import Random
from typing import Any

DEPTH = 50_000
"""Levels of a value that is nested too deeply for any parser that calls itself."""

_RAW, _AGAIN = "\x01raw:", "\x01again:"
"""Marks in a document of what `json.dumps` would not write."""

_NUMBERS = [
    "0", "-0", "-1", "1", "2", "3", "255", "256", "65535", "65536", "2147483647", "-2147483648", "2147483648", "4294967295",
    "4294967296", "9007199254740993", "9223372036854775807", "-9223372036854775808", "9223372036854775808", "18446744073709551616",
    "1e5", "1e6", "1e9", "1e19", "1e308", "-1e308", "1e309", "1e-320", "0.1", "-0.5", "3.0", "NaN", "Infinity", "-Infinity",
    "1" + "0" * 400, "-" + "9" * 400, "1" + "0" * 5000, "0." + "3" * 400, "1e400", "1E+2", "007", "0x10", "1_000", "+1", ".5", "١٢٣",
]  # fmt: skip
_TEXTS = [
    "", " ", "\n", "\t", "a", "0", "-1", "1e9", "nan", "null", "true", "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "..", ".",
    "./.", "a/b/../../..", "C:\\x", "\\\\host\\x", "file:///etc/passwd", "http://127.0.0.1:9/x", "package://x/y", "data:,x",
    "data:image/png;base64,AAAA", "x" * 300, "x" * 70_000, "a\x00b", "\x1b[31mred\x1b[0m", "é", "客厅", "\u202etxt", "😀", "\ufeff",
    "*", "**/*", "[", "[!", "{x}", "%s%n", "%(x)s", "{{ x }}", "$(x)", "`x`", "'; DROP TABLE x; --", "<b>x</b>", "&x;", "|", "a|b|c|d",
    "2026-03-01T14:05:00Z", "2026-03-01", "9999-12-31T23:59:59-23:59", "0001-01-01T00:00:00+23:59", "24:00", "Infinity",
]  # fmt: skip
_OTHERS = [
    "null",
    "true",
    "false",
    "[]",
    "{}",
    "[[]]",
    "[null]",
    '{"a": 1}',
    "[1, 2]",
    "[1, 2, 3]",
    "[0, 0, 0, 0]",
    '""',
    '["a"]',
    '"\\ud800"',
]


def number(random: Random) -> str:
    """A number, as text, that somebody did not think of."""
    if random.random() < 0.7:
        return random.choice(_NUMBERS)
    return repr(random.choice([random.uniform(-10, 10), random.uniform(-1e7, 1e7), random.gauss(0, 1e-9), float(random.getrandbits(40))]))


def word(random: Random) -> str:
    """A text that somebody did not think of."""
    return random.choice(_TEXTS)


def changed_json(data: bytes, random: Random) -> bytes:
    """JSON with one change to its structure or a value. What is no JSON comes back as it is."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return data
    try:
        return _written(_changed(document, random))
    except RecursionError:  # an earlier change nested it so deeply
        return data


def _changed(document: Any, random: Random) -> Any:
    places = list(_places(document, [], 4000))
    if len(places) > 1 and random.random() < 0.97:
        places = places[1:]
    path = random.choice(places)
    if random.random() < 0.35:  # near the top there is little, and it matters most
        path = path[: random.randint(min(len(path), 1), min(len(path), 3))]
    if not path:
        return _value(document, random)
    holder: Any = document
    for key in path[:-1]:
        holder = holder[key]
    key = path[-1]
    choice = random.random()
    if choice < 0.55:
        holder[key] = _value(holder[key], random)
    elif choice < 0.67:
        del holder[key]
    elif choice < 0.73 and isinstance(holder, dict):
        holder[f"{_AGAIN}{key}"] = _value(holder[key], random)
    elif choice < 0.79 and isinstance(holder, dict):
        holder[word(random)] = holder.pop(key) if random.random() < 0.5 else holder[key]
    elif choice < 0.88 and isinstance(holder, list):
        times = random.choice([1, 1, 1, 2, 2, 10, 10, 100 if random.random() < 0.8 else 1000])
        holder[key:key] = [holder[key]] * times
    else:
        other = document
        for step in random.choice(places):
            other = other[step] if _has(other, step) else other
        holder[key] = json.loads(json.dumps(other))  # a value from elsewhere: right by itself, wrong here
    return document


def _has(value: Any, step: Any) -> bool:
    return (isinstance(value, dict) and step in value) or (isinstance(value, list) and isinstance(step, int) and step < len(value))


def _places(value: Any, path: list[Any], most: int) -> Any:
    """Paths of values, breadth by breadth, at most so many; long lists are looked at here and there."""
    queue: list[tuple[Any, list[Any]]] = [(value, path)]
    count = 0
    while queue and count < most:
        found, at = queue.pop(0)
        count += 1
        yield at
        if isinstance(found, dict):
            queue += [(item, [*at, key]) for key, item in found.items()]
        elif isinstance(found, list):
            step = max(1, len(found) // 40)
            queue += [(found[index], [*at, index]) for index in range(0, len(found), step)]


def near(old: Any, random: Random) -> Any:
    """A value like another, which may well pass: what comes after the first look at a file is to be met, too."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, int | float) and not abs(old) < 1e15:
        return 0
    if isinstance(old, int):
        return random.choice([old + 1, old - 1, -old, old * 2, float(old)])
    if isinstance(old, float):
        return random.choice([old * random.uniform(0.5, 2), -old, round(old), old + random.gauss(0, 1e-3)])
    if isinstance(old, str) and old:
        at = random.randrange(len(old))
        return random.choice([old[:at] + old[at + 1 :], old[:at] + old[at].swapcase() + old[at + 1 :], old + old[at], f" {old}"])
    if isinstance(old, list):
        return random.sample(old, len(old))
    return old


def _value(old: Any, random: Random) -> Any:
    choice = random.random()
    if random.random() < 0.25:
        return near(old, random)
    if isinstance(old, bool) or old is None:
        old = 0
    if isinstance(old, int | float) and choice < 0.6:
        return _RAW + number(random)
    if isinstance(old, str) and choice < 0.6:
        return word(random)
    if isinstance(old, list) and choice < 0.5 and old:
        cut = random.choice([0, 1, len(old) - 1, len(old) // 2])
        return old[:cut] if random.random() < 0.6 else old + old[: random.choice([1, 2, len(old)])]
    if choice < 0.75:
        return _RAW + number(random)
    if choice < 0.87:
        return word(random)
    if choice < 0.97:
        return _RAW + random.choice(_OTHERS)
    opening, closing = random.choice([("[", "]"), ('{"a":', "}"), ('[{"children":', "}]")])
    levels = random.choice([2, 60, 900, 5000, DEPTH])
    return f"{_RAW}{opening * levels}1{closing * levels}"


def _written(document: Any) -> bytes:
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False)
    raw = '"' + json.dumps(_RAW)[1:-1]
    parts = text.split(raw)
    out = [parts[0].replace(json.dumps(_AGAIN)[1:-1], "")]
    for part in parts[1:]:
        end = _string_end(part)
        out.append(json.loads(f'"{part[:end]}"') if end >= 0 else part)
        out.append(part[end + 1 :].replace(json.dumps(_AGAIN)[1:-1], ""))
    return "".join(out).encode("utf-8", "surrogatepass")


def _string_end(text: str) -> int:
    """Where the string ends that `text` begins inside of."""
    at = 0
    while at < len(text):
        if text[at] == "\\":
            at += 2
            continue
        if text[at] == '"':
            return at
        at += 1
    return -1
