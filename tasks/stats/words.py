"""The word cloud of categories (supplementary, Fig. A4)."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from tasks.stats.style import PAPER, SERIES, Picture, raster_of, themed

if TYPE_CHECKING:
    from wordcloud import WordCloud

SEED = 7
"""Any number; fixed, so that the same counts give the same cloud."""

WORD_LIMIT = 200
"""More words than that are too small to be read."""


MIN_LETTERS_PX = 10
"""Size of the smallest letters [px]: smaller ones cannot be read."""


def word_cloud(counts: Mapping[str, int]) -> Picture | None:
    """Categories, the size of each by its count. None without categories."""
    words = {word: count for word, count in sorted(counts.items()) if count > 0 and word.strip()}
    if not words:
        return None
    cloud = _layout(words)
    svg = re.sub(r"<rect[^>]*/>|<rect[^>]*></rect>", "", cloud.to_svg(embed_font=False), count=1)
    svg = re.sub(r"rgb\((\d+), ?(\d+), ?(\d+)\)", lambda m: "#{:02x}{:02x}{:02x}".format(*map(int, m.groups())), svg)
    # without the font in the file, another monospaced one steps in and is made as wide
    svg = svg.replace("'Droid Sans Mono'", "'Droid Sans Mono',monospace")
    svg = re.sub(r'font-size="(\d+)"([^>]*)>([^<]*)<', _fitted, svg)
    svg = re.sub(r"<text[^>]*>([^<]*)</text>", lambda match: _counted(match[0], match[1], words), svg)
    svg = svg.replace("<svg ", '<svg viewBox="0 0 900 560" ', 1)
    frequent = sorted(words, key=lambda word: (-words[word], word))[:5]
    alt = f"Word cloud of {len(words)} categories. Most frequent: " + ", ".join(f"{word} ({words[word]})" for word in frequent) + "."
    return Picture("category_cloud", "Categories", alt, themed(svg), raster_of(lambda: _png(cloud)), view="category_counts")


def _png(cloud: WordCloud) -> bytes:
    file = io.BytesIO()
    cloud.to_image().save(file, "PNG")
    return file.getvalue()


def _layout(words: Mapping[str, int]) -> WordCloud:
    """Cloud with the largest letters at which all words fit.

    The size of a word follows from its count alone: linear from `MIN_LETTERS_PX` at no object to the
    largest letters at the greatest count. Words that do not fit with the smallest letters are left out.
    """
    from wordcloud import WordCloud

    greatest = max(words.values())
    for largest in _LETTER_SIZES:
        sizes_px = {word: round(MIN_LETTERS_PX + (largest - MIN_LETTERS_PX) * count / greatest) for word, count in words.items()}
        cloud = WordCloud(
            width=900,
            height=560,
            margin=10,
            random_state=SEED,
            prefer_horizontal=0.9,
            max_words=WORD_LIMIT,
            max_font_size=largest,
            min_font_size=MIN_LETTERS_PX,
            relative_scaling=1.0,  # sizes as given: with less, the rank counts too
            background_color=PAPER.light,
            color_func=_color,
        ).generate_from_frequencies(sizes_px)
        # A word that found no place was drawn smaller, and rounding adds up from word to word.
        is_as_stated = all(abs(size - sizes_px[word]) <= MAX_ROUNDING_PX for (word, _), size, _, _, _ in cloud.layout_)
        sizes_by_count = {(words[word], size) for (word, _), size, _, _, _ in cloud.layout_}
        has_one_size_each = len(sizes_by_count) == len({count for count, _ in sizes_by_count})
        if len(cloud.layout_) == min(len(words), WORD_LIMIT) and is_as_stated and has_one_size_each:
            return cloud
    cloud.layout_ = [entry for entry in cloud.layout_ if abs(entry[1] - sizes_px[entry[0][0]]) <= MAX_ROUNDING_PX]
    return cloud


_LETTER_SIZES = (150, 120, 96, 76, 60, 48, 38, 30, 24, 20, 16, 13, 11)
"""Sizes of the largest letters [px] that are tried, in this order."""

MAX_ROUNDING_PX = 1
"""Largest deviation of a drawn size from the stated one [px]: sizes are whole pixels."""


def _fitted(match: re.Match[str]) -> str:
    """A word of the SVG with its width fixed: Droid Sans Mono's letters are 0.6 em wide."""
    size, rest, word = int(match[1]), match[2], match[3]
    return f'font-size="{size}" textLength="{0.6 * size * len(html.unescape(word)):.1f}" lengthAdjust="spacingAndGlyphs"{rest}>{word}<'


def _counted(text: str, word: str, words: Mapping[str, int]) -> str:
    """A word of the SVG with what it stands for as its title."""
    count = words[html.unescape(word)]
    return f'<g class="tip"><title>{word}: {count} object{"" if count == 1 else "s"}</title>{text}</g>'


def _color(word: str, random_state: Any = None, **_: Any) -> str:
    """A color of the palette, chosen by the cloud's own seeded generator."""
    return SERIES[random_state.randrange(len(SERIES) - 1)].light
