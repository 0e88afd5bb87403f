"""SQL as it is typed, line by line: where a statement ends, and how it looks in one line."""

from __future__ import annotations

import re

# What may hold a semicolon that ends nothing: texts (e'it\'s' has escapes), names in quotes, dollar quotes, comments. Words are pieces,
# too: a dollar inside of a name quotes nothing.
_PIECE = re.compile(
    r"""
      (?P<text>[eE]'(?:[^'\\]|\\.|'')*' | '(?:[^']|'')*' | "(?:[^"]|"")*")
    | \$(?P<tag>[^\W\d]\w*)?\$.*?\$(?(tag)(?P=tag))\$
    | (?P<open>[eE]?'|"|\$(?:[^\W\d]\w*)?\$)
    | (?P<word>[^\W\d][\w$]*)
    | (?P<comment>--[^\n]*(?:\n|\Z))
    | (?P<block>/\*)
    | (?P<end>;)
    | (?P<other>.)
    """,
    re.VERBOSE | re.DOTALL,
)
_BLOCK = re.compile(r"/\*|\*/")


def parted(text: str) -> tuple[list[str], str]:
    """The statements of a text that are ended by a semicolon, without it, and what is left behind the last of them."""
    statements, begin, at = [], 0, 0
    while at < len(text):
        piece = _PIECE.match(text, at)
        assert piece is not None
        if piece["open"]:  # and not closed in what there is
            break
        at = piece.end()
        if piece["block"]:
            end = _block_end(text, at)
            if end is None:
                break
            at = end
        elif piece["end"]:
            statements.append(text[begin : piece.start()])
            begin = at
    return [statement for statement in statements if not is_blank(statement)], text[begin:]


def is_blank(text: str) -> bool:
    """Whether there is nothing but space and comments in a text, all of them closed."""
    at = 0
    while at < len(text):
        piece = _PIECE.match(text, at)
        assert piece is not None
        at = piece.end()
        if piece["block"]:
            end = _block_end(text, at)
            if end is None:
                return False
            at = end
        elif not piece["comment"] and not piece[0].isspace():
            return False
    return True


def in_one_line(statement: str) -> str:
    """The same statement in one line, as a history keeps it. Line breaks inside of texts become spaces, too."""
    parts, at = [], 0
    while at < len(statement):
        piece = _PIECE.match(statement, at)
        assert piece is not None
        at = piece.end()
        if piece["block"]:
            end = _block_end(statement, at) or len(statement)
            parts.append(statement[piece.start() : end])
            at = end
        elif piece["comment"]:
            inner = piece[0].strip().removeprefix("--").strip().replace("*/", "* /").replace("/*", "/ *")
            parts.append(f"/* {inner} */ ")
        else:
            parts.append(piece[0])
    return " ".join("".join(parts).split("\n")).strip()


def _block_end(text: str, at: int) -> int | None:
    """Where a comment ends that begins before `at`, comments inside of it included; None where it does not."""
    level = 1
    while level:
        mark = _BLOCK.search(text, at)
        if mark is None:
            return None
        level += 1 if mark[0] == "/*" else -1
        at = mark.end()
    return at
