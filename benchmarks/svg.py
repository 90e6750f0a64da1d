"""Charts as SVG text, for benchmarks that draw without a library: points and lines on logarithmic axes, and heat maps.

In: numbers. Out: strings; `page` puts panels, each WIDTH x HEIGHT, side by side and makes the file's text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

WIDTH, HEIGHT = 460, 340
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 44, 46


@dataclass(frozen=True)
class Series:
    """Points (n, 2), all above 0. labels: a text beside each, or none. line: joined in order; dashed: the line has gaps. radius:
    of the dots, 0 for none; hollow: dots are rings."""

    points: Sequence[tuple[float, float]]
    color: str
    labels: Sequence[str] = ()
    line: bool = False
    dashed: bool = False
    radius: float = 3.5
    hollow: bool = False


def text(x: float, y: float, words: str, size: int = 11, anchor: str = "middle", turn: int = 0, color: str = "#222") -> str:
    turned = f' transform="rotate({turn} {x:.1f} {y:.1f})"' if turn else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" fill="{color}"{turned}>{escape(words)}</text>'


def ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten within the limits; powers alone where they are many."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1,) if math.log10(high / low) > 2.5 else (1, 2, 5)
    return [t for d in decades for m in steps if low <= (t := m * 10.0 ** d) <= high]


def number(t: float) -> str:
    return f"{t:g}" if t >= 1e-3 else f"{t:.0e}".replace("e-0", "e-")


def chart(title: str, x_name: str, y_name: str, series: Sequence[Series], legend: Mapping[str, str]) -> str:
    """A panel with two logarithmic axes; legend: name -> colour."""
    points = np.array([p for s in series for p in s.points], float)
    low, high = points.min(0), points.max(0)
    margin = np.maximum((high / low) ** 0.07, 1.1)
    low, high = low / margin, high * margin

    def at(p: Sequence[float]) -> tuple[float, float]:
        f = np.log(np.asarray(p) / low) / np.log(high / low)
        return LEFT + f[0] * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - f[1] * (HEIGHT - TOP - BOTTOM)

    out = [text(WIDTH / 2, 18, title, 13)]
    for axis, (a, b) in enumerate(zip(low, high)):
        for t in ticks(a, b):
            x, y = at([t, low[1]] if axis == 0 else [low[0], t])
            if axis == 0:
                out += [f'<path d="M{x:.1f} {y:.1f}V{TOP}" stroke="#e4e4e4"/>', text(x, y + 15, number(t))]
            else:
                out += [f'<path d="M{x:.1f} {y:.1f}H{WIDTH - RIGHT}" stroke="#e4e4e4"/>', text(x - 5, y + 4, number(t), anchor="end")]
    out.append(f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH - LEFT - RIGHT}" height="{HEIGHT - TOP - BOTTOM}" fill="none" stroke="#888"/>')
    out += [text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 12, x_name), text(16, (TOP + HEIGHT - BOTTOM) / 2, y_name, turn=-90)]
    dots, labels = [], []
    for s in series:
        places = [at(p) for p in s.points]
        if s.line:
            d, gaps = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places), ' stroke-dasharray="5 4"' if s.dashed else ""
            out.append(f'<path d="{d}" fill="none" stroke="{s.color}"{gaps}/>')
        for x, y in places if s.radius else ():
            fill = "none" if s.hollow else s.color
            out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{s.radius:g}" fill="{fill}" stroke="{s.color}"/>')
        dots += [(x - s.radius, y - s.radius, x + s.radius, y + s.radius) for x, y in places]
        labels += [(x, y, label, s.color) for (x, y), label in zip(places, s.labels) if label]
    out += beside(labels, dots)
    for k, (name, color) in enumerate(legend.items()):
        x = LEFT + 84 * k
        out += [f'<rect x="{x}" y="29" width="9" height="9" fill="{color}"/>', text(x + 14, 38, name, 10, "start")]
    return "\n".join(out)


def beside(labels: Sequence[tuple[float, float, str, str]], taken: Sequence[tuple[float, float, float, float]]) -> list[str]:
    """Texts for points (x, y, text, colour): each where it hides least of what is taken (left, top, right, bottom) and of the texts
    before it, within the axes."""
    taken, out = list(taken), []
    for x, y, label, color in labels:
        wide, best = 5.4 * len(label), None
        for dx, dy in ((6, -4), (6, 11), (-6 - wide, -4), (-6 - wide, 11), (-wide / 2, -7), (-wide / 2, 15), (11, 3), (-11 - wide, 3),
                       (6, -14), (6, 21), (-6 - wide, -14), (-6 - wide, 21)):
            box = (x + dx, y + dy - 7, x + dx + wide, y + dy)
            outside = max(LEFT - box[0], box[2] - (WIDTH - RIGHT), TOP - box[1], box[3] - (HEIGHT - BOTTOM), 0)
            hidden = 100 * outside + sum(max(0.0, min(box[2], t[2]) - max(box[0], t[0])) * max(0.0, min(box[3], t[3]) - max(box[1], t[1]))
                                         for t in taken)
            if best is None or hidden < best[0]:
                best = hidden, box
        taken.append(best[1])
        out.append(text(best[1][0], best[1][3], label, 9, "start", color=color))
    return out


def heat(title: str, columns: Sequence[str], rows: Sequence[str], values: Mapping[tuple[str, str], float]) -> str:
    """A panel of cells by (row, column), the least value lightest, its number in each; what is missing stays empty."""
    logs = [math.log(v) for v in values.values()]
    low, span = min(logs), max(max(logs) - min(logs), 1e-9)
    w, h = (WIDTH - LEFT - RIGHT) / len(columns), (HEIGHT - TOP - BOTTOM) / len(rows)
    out = [text(WIDTH / 2, 18, title, 13)]
    for i, row in enumerate(rows):
        out.append(text(LEFT - 6, TOP + (i + 0.5) * h + 4, row, anchor="end"))
        for j, column in enumerate(columns):
            x, y, v = LEFT + j * w, TOP + i * h, values.get((row, column))
            if v is None:
                out.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="none" stroke="#ddd"/>')
                continue
            f = (math.log(v) - low) / span
            r, g, b = (round(p + (q - p) * f) for p, q in zip((255, 247, 220), (120, 20, 60)))
            out.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="rgb({r},{g},{b})" stroke="#fff"/>')
            out.append(text(x + w / 2, y + h / 2 + 4, f"{v:.4f}", 12, color="#fff" if f > 0.5 else "#222"))
    out += [text(LEFT + (j + 0.5) * w, HEIGHT - BOTTOM + 16, column) for j, column in enumerate(columns)]
    return "\n".join(out)


def page(panels: Sequence[str], across: int = 2) -> str:
    """The text of an SVG file."""
    down = -(-len(panels) // across)
    size = f"{WIDTH * min(across, len(panels))} {HEIGHT * down}"
    w, h = size.split()
    groups = [f'<g transform="translate({k % across * WIDTH} {k // across * HEIGHT})">\n{panel}\n</g>' for k, panel in enumerate(panels)]
    return "\n".join([f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" width="{w}" height="{h}" font-family="sans-serif">',
                      f'<rect width="{w}" height="{h}" fill="#fff"/>', *groups, "</svg>", ""])
