"""Charts as part of a page: their SVG in its text, in its colors, with ids that no other chart has."""

from __future__ import annotations

import html
import re

from tasks.stats.style import Picture


def inlined(picture: Picture) -> str:
    """The SVG of a picture for the text of an HTML page that has the palette's colors as variables.

    It is a group of marks, named by what is to be seen. Ids that something refers to begin with the picture's name, others go.
    """
    svg = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>|<style[^>]*>.*?</style>", "", picture.svg, flags=re.DOTALL)
    svg = re.sub(r">\s+<", "><", svg)
    head, _, rest = svg.partition(">")
    rest = re.sub(r"^\s*<title>[^<]*</title>", "", rest)
    wanted = set(re.findall(r'url\(#([^)"]+)\)|href="#([^"]+)"', rest))
    names = {name for pair in wanted for name in pair if name}
    stem = re.sub(r"[^A-Za-z0-9_-]", "-", picture.name)

    def kept(match: re.Match[str]) -> str:
        return f' id="{stem}-{match[1]}"' if match[1] in names else ""

    rest = re.sub(r' id="([^"]*)"', kept, rest)
    rest = re.sub(r'(url\(#|href="#)', rf"\g<1>{stem}-", rest)
    box = re.search(r'viewBox="[^"]*"', head)
    stop = ' tabindex="0"' if 'class="tip"' in rest else ""
    return f'<svg {box[0] if box else ""} role="group" aria-label="{html.escape(picture.alt)}"{stop}>{rest}'
