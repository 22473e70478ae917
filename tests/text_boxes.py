"""Texts of a matplotlib figure that lie on one another or leave the picture, by matplotlib's own boxes."""

from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from PIL import Image

SLACK = 1.5
"""Pixels by which boxes may touch: they are a little larger than the letters."""


def faults(figure):
    """What is wrong with the texts of a figure, in words."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()  # places the texts, and fills no pixels
    boxes, left_out = [], _not_drawn(figure)
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in left_out:
            box = text.get_window_extent(renderer)
            if box.width > 0.0 and box.height > 0.0:
                boxes.append((text.get_text().replace("\n", " "), box))
    whole = figure.bbox
    found = [
        f"{words!r} leaves the picture"
        for words, box in boxes
        if box.x0 < whole.x0 - SLACK
        or box.y0 < whole.y0 - SLACK
        or box.x1 > whole.x1 + SLACK
        or box.y1 > whole.y1 + SLACK
    ]
    for (one, a), (other, b) in combinations(boxes, 2):
        across, up = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if across > SLACK and up > SLACK:
            found.append(f"{one!r} lies on {other!r}")
    return found


def save_square(_figure, file, **_):
    """Save a black square in place of a figure, whose texts take most of the time to draw."""
    Image.new("RGB", (8, 8)).save(file, format="PNG")


def _not_drawn(figure):
    """Labels of ticks beyond the range of their axis, which matplotlib keeps without drawing them."""
    left_out = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_transform().transform(axis.get_view_interval()))
            room = 1e-6 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                place = axis.get_transform().transform([tick.get_loc()])[0]
                if not low - room <= place <= high + room:
                    left_out |= {tick.label1, tick.label2}
    return left_out
