"""Small pieces of HTML for notebooks: everything that comes from a user's file is escaped here, once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

_LINE = "border-bottom:1px solid rgba(128,128,128,.35)"
_SHORT = 28
_VERDICTS = {"PASS": "#00805f", "FAIL": "#d23c00", "TOO CLOSE": "#2a6fc4", "MISSING": "#a67c00"}


def card(title: object, subtitle: object = "", *parts: str) -> str:
    """A titled block; title and subtitle are escaped, the parts are HTML that was made here.

    >>> card("a < b")
    '<div class="livlab"><p><strong>a &lt; b</strong></p></div>'
    """
    small = f' <span style="opacity:.7">{escape(str(subtitle))}</span>' if subtitle else ""
    return f'<div class="livlab"><p><strong>{escape(str(title))}</strong>{small}</p>{"".join(parts)}</div>'


def table(columns: Sequence[object], rows: Iterable[Sequence[object]], *, most: int = 60) -> str:
    """A table; numbers to the right with six digits, None and nan as a dash, at most `most` rows.

    >>> "&lt;script&gt;" in table(["name"], [["<script>"]])
    True
    """
    body = []
    left_out = 0
    for number, row in enumerate(rows):
        if number >= most:
            left_out += 1
            continue
        body.append("<tr>" + "".join(_cell(value) for value in row) + "</tr>")
    head = "".join(f'<th style="text-align:left;{_LINE}">{escape(str(c))}</th>' for c in columns)
    more = f'<p style="opacity:.7">and {left_out} more rows</p>' if left_out else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>{more}"


def notes(texts: Iterable[object]) -> str:
    """A list of sentences; nothing where there are none."""
    items = "".join(f"<li>{escape(str(text))}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def warning(text: object) -> str:
    """A sentence that must not be overlooked.

    >>> "a &lt; b" in warning("a < b")
    True
    """
    return f'<p><b style="color:{_VERDICTS["FAIL"]}">{escape(str(text))}</b></p>'


def swatch(rgb: Sequence[float], title: str = "") -> str:
    """A patch of colour from sRGB values, encoded, 0–1."""
    coded = "".join(f"{round(255 * min(max(float(c), 0.0), 1.0)):02x}" for c in rgb)
    look = f"display:inline-block;width:2.4em;height:1.2em;background:#{coded};border:1px solid rgba(128,128,128,.5)"
    return f'<span title="{escape(title, quote=True)}" style="{look};vertical-align:middle"></span>'


def curve(x: Sequence[float], y: Sequence[float], label: str) -> str:
    """A small line drawing of a curve, in the colour of the text around it; its axes' ends are written beside it."""
    points = [(float(a), float(b)) for a, b in zip(x, y, strict=True) if math.isfinite(a) and math.isfinite(b)]
    if len(points) < 2:
        return ""
    left, right = points[0][0], points[-1][0]
    top = max(0.0, *(b for _, b in points))
    low = min(0.0, *(b for _, b in points))
    high = (top - low) or 1.0
    wide = (right - left) or 1.0
    drawn = " ".join(f"{4 + 232 * (a - left) / wide:.1f},{66 - 60 * (b - low) / high:.1f}" for a, b in points)
    text = 'font-size="9" fill="currentColor" opacity=".7"'
    return (
        f'<svg role="img" aria-label="{escape(label, quote=True)}" width="300" height="82" viewBox="0 0 300 82">'
        f'<polyline fill="none" stroke="currentColor" stroke-width="1.6" points="{drawn}"/>'
        f'<line x1="4" x2="236" y1="67" y2="67" stroke="currentColor" opacity=".4"/>'
        f'<text x="4" y="79" {text}>{left:g} nm</text><text x="200" y="79" {text}>{right:g} nm</text>'
        f'<text x="242" y="12" {text}>{top:.3g}</text><text x="242" y="69" {text}>{low:.3g}</text></svg>'
    )


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "<td>–</td>"
    if isinstance(value, bool):
        return f"<td>{'yes' if value else 'no'}</td>"
    if isinstance(value, float):
        return f'<td style="text-align:right">{value:.6g}</td>'
    if isinstance(value, int):
        return f'<td style="text-align:right">{value}</td>'
    shown = escape(str(value))
    ink = _VERDICTS.get(str(value))
    whole = ";white-space:nowrap" if len(str(value)) <= _SHORT else ""
    return f'<td style="text-align:left{whole}">{f"<b style=color:{ink}>{shown}</b>" if ink else shown}</td>'
