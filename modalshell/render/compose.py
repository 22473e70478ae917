"""Page layout: places of images, titles, legend and colour bar; text by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.render.surfaces import ScalarColors

# Legend entry: label, colour (3,) in [0, 1], opacity.
Entry = tuple[str, NDArray[np.float64], float]


@dataclass
class Page:
    """A page of equal cells under text that never reaches into them."""

    size: tuple[int, int]
    """Width and height [pixels]."""
    captions: list[tuple[str | None, str | None]]
    """Title and subtitle of each cell."""
    columns: int
    """Cells in a row."""
    title: str | None = None
    """Text at the top of the page."""
    legend: Sequence[Entry] = ()
    """Label, colour and opacity of each entry."""
    bar: ScalarColors | None = None
    """Colour bar on the right."""
    bar_label: str | None = None
    """Its title."""
    headings: Sequence[str] = ()
    """Text at the left above each row, or none."""

    def __post_init__(self) -> None:
        """Measure the text and lay out the page."""
        width, height = self.size
        rows = -(-len(self.captions) // self.columns)
        self.font = float(np.clip(min(height / 40.0, width / 60.0, 2.0 * height / (20.0 * rows)), 9.0, 40.0))
        line = 1.35 * self.font
        self._bar_width = round(6.5 * self.font) if self.bar else 0
        inner = width - self._bar_width
        self._cell_width = inner // self.columns
        self._page_title = self._wrap(self.title, width - 2 * self.font, 1.25 * self.font)
        self._texts = [
            (self._wrap(head, 0.94 * self._cell_width, self.font),
             self._wrap(sub, 0.94 * self._cell_width, 0.85 * self.font))
            for head, sub in self.captions
        ]  # fmt: skip
        self._head = max(text.count("\n") + 1 if text else 0 for text, _ in self._texts) * line
        self._sub = max(text.count("\n") + 1 if text else 0 for _, text in self._texts) * 0.85 * line
        self._legend_rows = self._pack_legend(inner)
        lines = self._page_title.count("\n") + 1 if self._page_title else 0
        self._top = round(1.25 * line * lines + 0.5 * line * bool(lines))
        self._bottom = round(1.5 * line * len(self._legend_rows) + 0.4 * line * bool(self._legend_rows))
        caption = round(self._head + self._sub + 0.6 * line * bool(self._head + self._sub))
        caption += round(line) * bool(self.headings)
        row_height = (height - self._top - self._bottom) // rows
        self.cell = (max(self._cell_width, 8), max(row_height - caption, 8))
        self.corners: list[tuple[int, int]] = []
        for index in range(len(self.captions)):
            row, column = divmod(index, self.columns)
            # A last row that is not full is centred.
            in_row = min(self.columns, len(self.captions) - row * self.columns)
            shift = (inner - in_row * self._cell_width) // 2
            self.corners.append((shift + column * self._cell_width, self._top + row * row_height + caption))

    @cached_property
    def _figure(self) -> Any:
        from matplotlib.figure import Figure  # not before there is text: its import takes long

        # 72 dots per inch make one point one pixel.
        return Figure(figsize=(self.size[0] / 72.0, self.size[1] / 72.0), dpi=72, facecolor="white")

    def paint(self, images: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the page (height, width, 3) with the images of the cells in place."""
        if self._page_title or self._head or self._sub or self.headings or self.legend or self.bar:
            page = self._paint_text()
        else:
            page = np.full((self.size[1], self.size[0], 3), 255, np.uint8)
        for corner, image in zip(self.corners, images, strict=True):
            paste(page, corner, image)
        return page

    def _paint_text(self) -> NDArray[np.uint8]:
        """The page without images."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.patches import Rectangle

        height, figure, line = self.size[1], self._figure, 1.35 * self.font
        if self._page_title:
            self._text(self.size[0] / 2, height - 0.4 * line, self._page_title, 1.25 * self.font, weight="bold")
        for (left, top), (head, sub) in zip(self.corners, self._texts, strict=True):
            middle, foot = left + self._cell_width / 2, height - top + 0.2 * line
            if head:
                self._text(middle, foot + self._sub + 0.2 * line, head, self.font, weight="bold", va="bottom")
            if sub:
                self._text(middle, foot + self._sub, sub, 0.85 * self.font, color="0.3")
        for row, heading in enumerate(self.headings):
            foot = height - self.corners[row * self.columns][1] + self._head + self._sub + 0.6 * line
            self._text(0.5 * self.font, foot, heading, self.font, ha="left", va="bottom", style="italic")
        for row, entries in enumerate(self._legend_rows):
            at = (self.size[0] - self._bar_width - sum(width for width, _ in entries)) / 2
            base = self._bottom - 1.5 * line * (row + 1)
            for width, (label, color, opacity) in entries:
                box = Rectangle((at, base), 1.4 * self.font, 0.9 * self.font, transform=None)
                box.set(facecolor=(*color, max(opacity, 0.35)), edgecolor=0.45 * color, linewidth=1.0)
                figure.add_artist(box)
                self._text(at + 2.0 * self.font, base + 0.05 * self.font, label, self.font, ha="left", va="baseline")
                at += width
        if self.bar:
            self._paint_bar(self.bar)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
        return np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])

    def _paint_bar(self, bar: ScalarColors) -> None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize
        from matplotlib.ticker import MaxNLocator

        width, height = self.size
        pad = 0.5 if bar.high == bar.low else 0.0
        left = (width - self._bar_width + 0.5 * self.font) / width
        bottom, top = (self._bottom + 0.14 * height) / height, 1.0 - (self._top + 0.14 * height) / height
        axes = self._figure.add_axes((left, bottom, 0.9 * self.font / width, top - bottom))
        colors = ScalarMappable(Normalize(bar.low - pad, bar.high + pad), bar.colormap)
        colorbar: Any = self._figure.colorbar(colors, cax=axes)
        colorbar.ax.tick_params(labelsize=0.8 * self.font)
        offset = colorbar.ax.yaxis.get_offset_text()
        offset.set_fontsize(0.8 * self.font)
        offset.set_horizontalalignment("left")  # else a power of ten is cut by the picture
        colorbar.locator = MaxNLocator(nbins=5)
        colorbar.formatter.set_powerlimits((-3, 4))
        colorbar.update_ticks()
        if self.bar_label:
            colorbar.set_label(self.bar_label, fontsize=0.9 * self.font, parse_math=False)

    def _text(self, x: float, y: float, text: str, size: float, **style: Any) -> None:
        options: dict[str, Any] = {"ha": "center", "va": "top", "color": "0.1", "linespacing": 1.15, **style}
        from matplotlib.transforms import IdentityTransform

        self._figure.text(x, y, text, fontsize=size, transform=IdentityTransform(), parse_math=False, **options)

    def _width(self, text: str, size: float) -> float:
        probe = self._figure.text(0, 0, text, fontsize=size, weight="bold", parse_math=False)
        measured = float(probe.get_window_extent().width)
        probe.remove()
        return measured

    def _wrap(self, text: str | None, room: float, size: float) -> str:
        """Break text at spaces so that each line fits `room` pixels; a single long word stays whole."""
        lines: list[str] = []
        for paragraph in (text or "").splitlines():
            current = ""
            for word in paragraph.split():
                longer = f"{current} {word}".strip()
                if current and self._width(longer, size) > room:
                    lines.append(current)
                    longer = word
                current = longer
            lines.append(current)
        return "\n".join(lines)

    def _pack_legend(self, room: int) -> list[list[tuple[float, Entry]]]:
        """Fill rows of the legend from left to right: lists of width in pixels and entry."""
        rows: list[list[tuple[float, Entry]]] = []
        for entry in self.legend:
            width = self._width(entry[0], self.font) + 3.6 * self.font
            if not rows or sum(taken for taken, _ in rows[-1]) + width > room:
                rows.append([])
            rows[-1].append((width, entry))
        return rows


def paste(page: NDArray[np.uint8], corner: tuple[int, int], image: NDArray[np.uint8]) -> None:
    """Copy an image into a page with its upper left at `corner` (column, row)."""
    left, top = corner
    target = page[top : top + image.shape[0], left : left + image.shape[1]]
    target[:] = image[: target.shape[0], : target.shape[1]]
