"""Text that is fit to be shown: no credentials, and no characters that would command a terminal.

Whatever a file, a row or a person's command may hold goes through here before it is printed, logged, raised or kept.
"""

from __future__ import annotations

import os
import re

SHOWN = 60
"""Characters of a value or a name that an error repeats."""

HIDDEN = "..."
"""Stands where a credential stood."""

# Values end at a backslash, too: in JSON it stands before the quote or the new line that follows.
_SECRETS = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
_SHORTEST_SECRET = 8  # shorter ones may be part of any word

_ADDRESS = re.compile(
    r"(?<![a-z0-9+.-])(?P<scheme>(?:s3|gs|https?|ftp):/*|[a-z][a-z0-9+.-]{0,30}://)(?P<rest>[^\s'\"<>`\\]*)", re.IGNORECASE
)
_AFTER = ":;,.)]}"  # what a sentence puts after an address
_CREDENTIAL = re.compile(
    r"(?<![\w.-])(?P<name>(?:x-amz-|x-goog-|aws_?)[\w.-]+"
    r"|[\w.-]{0,40}?(?:secret|passw|signature|credential|access_?key|session_?token)[\w.-]{0,40})=(?!\.\.\.)[^&#;\s'\"\\]+",
    re.IGNORECASE,
)
_VALUE = re.compile(r"=(?!\.\.\.)[^&;]+")

# What moves the cursor, colors, rings, deletes or turns the reading direction over: C0 but for new line and tab, DEL, C1,
# line and paragraph separators, marks of direction, invisible tags, and halves of pairs, which no encoding can write.
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)


def cut(text: str, most: int = SHOWN) -> str:
    """A text of at most `most` characters; three dots stand for the rest."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def escaped(text: str) -> str:
    r"""The same text with characters that command a terminal as ``\u001b``, in JSON's notation: JSON stays what it says."""
    return _COMMANDS.sub(_code, text)


def concealed(text: str) -> str:
    """The same text without credentials: user and password of addresses, signed queries, and what the AWS tools are told.

    ``s3://KEY:SECRET@bucket/lake`` becomes ``s3://...@bucket/lake``.
    """
    if ":" in text:
        text = _ADDRESS.sub(_address, text)
    if "=" in text:
        text = _CREDENTIAL.sub(rf"\g<name>={HIDDEN}", text)
    for name in _SECRETS:
        secret = os.environ.get(name, "")
        if len(secret) >= _SHORTEST_SECRET:
            text = text.replace(secret, HIDDEN)
    return text


def shown(text: str) -> str:
    """Text as it may be shown: `concealed` and `escaped`."""
    return escaped(concealed(text))


def one_line(text: object) -> str:
    """Anything's text, as it may be shown, in one line."""
    return shown(" ".join(str(text).split()))


_MARKS = re.compile(r"[\\|`*\[\]]")


def markdown_cell(value: object) -> str:
    """Anything's text, as it may be shown, for a line or a table cell of Markdown: no table, link, image, code or HTML begins in it."""
    text = f"{value:,}" if isinstance(value, int) else one_line(value)
    return _MARKS.sub(lambda mark: f"\\{mark[0]}", text).replace("<", "&lt;")


def page_text(text: str) -> str:
    """A page for people, with lines: control characters other than new lines are escaped or, if they are tabs, spaces."""
    return escaped(text.replace("\t", " "))


def is_one_line(text: str) -> bool:
    """True if a text has no line breaks, tabs or characters that command a terminal."""
    return not _COMMANDS.search(text) and not any(sign in text for sign in "\n\t")


def _code(match: re.Match[str]) -> str:
    code = ord(match[0])
    if code < 0x10000:
        return f"\\u{code:04x}"
    return f"\\u{0xD800 + (code - 0x10000 >> 10):04x}\\u{0xDC00 + (code & 0x3FF):04x}"


def _address(match: re.Match[str]) -> str:
    scheme, rest = match["scheme"], match["rest"].rstrip(_AFTER)
    after = match["rest"][len(rest) :]
    is_s3 = scheme[:3].lower() == "s3:"
    host, slash, path = rest.partition("/")
    _, colon, port = host.partition(":")
    if "@" in host:
        rest = f"{HIDDEN}@{host.rpartition('@')[2]}{slash}{path}"
    elif colon and (is_s3 or not port.isdigit()) and not host.startswith("["):
        # a password with a slash in it, as those of AWS have, or one without its @
        rest = f"{HIDDEN}@{path.rpartition('@')[2]}" if "@" in path else HIDDEN
    if is_s3 and "?" in rest:
        head, _, query = rest.partition("?")
        rest = f"{head}?{_VALUE.sub('=' + HIDDEN, query)}"
    return f"{scheme}{rest}{after}"
