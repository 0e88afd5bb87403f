"""One look for every picture: colors that a dark page can turn over, one font, the same bytes every time."""

from __future__ import annotations

import dataclasses
import functools
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from tasks.stats.tips import titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Tone:
    """A color by role: as drawn, on light ground, and what takes its place on dark ground."""

    role: str
    light: str
    dark: str


INK = Tone("ink", "#1c2430", "#e8ebf0")
MUTED = Tone("muted", "#566170", "#a9b3c0")
GRID = Tone("grid", "#dbe0e7", "#353e4a")
PAPER = Tone("paper", "#fdfdfc", "#12161c")

SERIES: tuple[Tone, ...] = (
    Tone("blue", "#2b6cb0", "#6fb1f5"),
    Tone("orange", "#b0500f", "#f6a15b"),
    Tone("green", "#2f7d55", "#5fc992"),
    Tone("purple", "#6b46c1", "#b69cf3"),
    Tone("red", "#c53030", "#fc8181"),
    Tone("teal", "#0e7490", "#4fd1dd"),
    Tone("ochre", "#8a6d0b", "#e0bf4e"),
    Tone("pink", "#b83280", "#f38bc0"),
    Tone("gray", "#64707f", "#98a4b3"),
)
"""Distinct hues, each at least 4.5:1 against the paper of its ground."""

_TONES = (INK, MUTED, GRID, PAPER, *SERIES)

WIDTH_INCHES = 4.5
"""Narrow, so that a phone shows the labels at nearly the size they were drawn in."""

PNG_DPI = 200
"""A picture of 4.5 inches becomes 900 pixels: sharp on a slide, small in a mail."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A finished picture. `svg` suits light and dark pages, `png` is for light ones; `alt` says what is to be seen.

    `png` is empty when only vectors were asked for.

    `view` is the one whose rows are drawn, when the picture is not named after it.
    """

    name: str
    title: str
    alt: str
    svg: str
    png: bytes
    view: str = ""

    @property
    def source(self) -> str:
        """The view whose rows are drawn."""
        return self.view or self.name


def in_style(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorator of a function that draws: all that it draws is in the common look."""

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib

        with matplotlib.rc_context(_SETTINGS):
            return draw(*args, **kwargs)

    return drawn


_RASTERS: ContextVar[bool] = ContextVar("rasters", default=True)


@contextmanager
def only_vectors() -> Iterator[None]:
    """Pictures that are drawn in this context have no PNG, which takes as long as all the rest of them."""
    before = _RASTERS.set(False)
    try:
        yield
    finally:
        _RASTERS.reset(before)


def raster_of(draw: Callable[[], bytes]) -> bytes:
    """The PNG that `draw` makes, or none when only vectors were asked for."""
    return draw() if _RASTERS.get() else b""


def canvas(height_inches: float) -> Axes:
    """The axes of a figure with one pair of them; call it inside a function that is `in_style`."""
    _, (axes,) = panels(1, 1, height_inches)
    return axes


def panels(rows: int, columns: int, height_inches: float) -> tuple[Figure, list[Axes]]:
    """A figure with several pairs of axes, row by row; call it inside a function that is `in_style`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_INCHES, height_inches), layout="constrained")
    grid = [figure.add_subplot(rows, columns, at + 1) for at in range(rows * columns)]
    for axes in grid:
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        axes.set_axisbelow(True)
    return figure, grid


def chart(axes: Axes, name: str, title: str, alt: str) -> Picture:
    """The figure of a canvas's axes as a picture, with its title above them."""
    axes.set_title(title)
    return picture(cast("Figure", axes.figure), name, title, alt)


def picture(figure: Figure, name: str, title: str, alt: str) -> Picture:
    """The figure as SVG and PNG, without dates: the same figure gives the same bytes."""
    import matplotlib

    def raster() -> bytes:
        file = io.BytesIO()
        figure.savefig(file, format="png", facecolor=PAPER.light, dpi=PNG_DPI, metadata={"Software": None})
        return file.getvalue()

    with matplotlib.rc_context({**_SETTINGS, "svg.hashsalt": name}):
        vector = io.StringIO()
        _arrange(figure)
        figure.savefig(vector, format="svg", transparent=True, metadata={"Date": None, "Creator": None, "Title": title})
        return Picture(name, title, alt, themed(titled(vector.getvalue())), raster_of(raster))


def _arrange(figure: Figure) -> None:
    """Lay a figure out once: each file would do it again, and draw everything twice for it."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def themed(svg: str) -> str:
    """The SVG with every color of the palette as a variable that turns over where the reader prefers dark."""
    for tone in _TONES:
        svg = re.sub(re.escape(tone.light), f"var(--{tone.role})", svg, flags=re.IGNORECASE)
    light = "".join(f"--{tone.role}:{tone.light};" for tone in _TONES)
    dark = "".join(f"--{tone.role}:{tone.dark};" for tone in _TONES)
    sheet = f"<style>svg{{{light}}}@media (prefers-color-scheme: dark){{svg{{{dark}}}}}</style>"
    head, tag, rest = svg[svg.index("<svg") :].partition(">")
    return f"{head}{tag}{sheet}{rest}"


_SETTINGS: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same letters on every machine
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.facecolor": "none",
    "axes.edgecolor": MUTED.light,
    "axes.labelcolor": INK.light,
    "axes.titlecolor": INK.light,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.grid.axis": "x",
    "grid.color": GRID.light,
    "grid.linewidth": 0.7,
    "text.color": INK.light,
    "xtick.color": MUTED.light,
    "ytick.color": MUTED.light,
    "xtick.labelcolor": INK.light,
    "ytick.labelcolor": INK.light,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.fonttype": "none",  # text stays text: small, searchable, and set in the reader's own font
    "svg.hashsalt": "metascenes",
}
