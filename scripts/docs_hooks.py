"""What the documentation's build adds to MkDocs: equations as drawings, and the commands' own help as a page.

Both are made while building, from what is installed with livlab. So the site needs no script from elsewhere to show an
equation, and the page of commands cannot lag behind the commands.
"""

from __future__ import annotations

import html
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

FRACTION, LARGE = r"\frac", r"\dfrac"
SEARCH = 'data-md-component="search" role="dialog"'
COMMANDS = "<!-- every command, by docs_hooks -->"
ELEMENTS = "<!-- every element, by docs_hooks -->"


def on_config(config: Any) -> Any:
    """Let fenced blocks named `math` be equations, as GitHub does, and add to the guide what the navigation forgot."""
    folder = Path(config.docs_dir)
    known = re.findall(r"[^'\"]+\.md", repr(config.nav))
    forgotten = sorted({p.relative_to(folder).as_posix() for p in folder.rglob("*.md")} - set(known))
    next(part["Guide"] for part in config.nav if "Guide" in part).extend(forgotten)
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {}).setdefault("custom_fences", [])
    fences.append({"name": "math", "class": "equation", "format": equation})
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put commands' help and elements where a page asks for them, and draw symbols between dollars, as GitHub does."""
    if COMMANDS in markdown:
        return markdown.replace(COMMANDS, commands())
    markdown = markdown.replace(ELEMENTS, elements()) if ELEMENTS in markdown else markdown
    if "```math" not in markdown:
        return markdown
    parts = re.split(r"(^```.*?^```|`[^`\n]+`)", markdown, flags=re.DOTALL | re.MULTILINE)
    parts[::2] = [re.sub(r"\$([^$\n]+)\$", lambda found: drawn(found[1]), part) for part in parts[::2]]
    return "".join(parts)


def on_post_page(output: str, **_: Any) -> str:
    """Name the theme's search for those who hear the page."""
    return output.replace(SEARCH, f'{SEARCH} aria-label="Search"')


def equation(source: str, *_: Any, **__: Any) -> str:
    """TeX lines as one SVG each, in the colour of the text around, named by their source for who cannot see them."""
    lines = [f"<p>{drawn(line.replace(FRACTION, LARGE))}</p>" for line in source.splitlines() if line.strip()]
    return f'<div class="equation" tabindex="0">{"".join(lines)}</div>'


@lru_cache
def drawn(tex: str) -> str:
    """One line of TeX as an SVG whose outlines need no font."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path as Outline
    from matplotlib.textpath import TextPath

    text = TextPath((0, 0), f"${tex.strip()}$", prop=FontProperties(size=15, math_fontfamily="cm"))
    box = text.get_extents()
    letters = dict(
        zip((Outline.MOVETO, Outline.LINETO, Outline.CURVE3, Outline.CURVE4, Outline.CLOSEPOLY), "MLQCZ", strict=True)
    )
    steps = [
        letters[code] + ("" if code == Outline.CLOSEPOLY else " ".join(f"{v:.2f}" for v in points))
        for points, code in text.iter_segments(simplify=False, curves=True)
    ]
    width, height = box.width + 2, box.height + 2
    return (
        f'<svg class="tex" role="img" aria-label="{html.escape(tex.strip())}" width="{width:.0f}" height="{height:.0f}"'
        f' style="vertical-align:{box.y0 - 1:.1f}px"'
        f' viewBox="{box.x0 - 1:.1f} {-box.y1 - 1:.1f} {width:.1f} {height:.1f}">'
        f'<path transform="scale(1 -1)" d="{"".join(steps)}"/></svg>'
    )


def commands() -> str:
    """Every command with its arguments and options, in Markdown."""
    from typer.main import get_command

    from livlab.cli.app import app

    return "\n".join(section(get_command(app), "livlab", 2))


def elements() -> str:
    """Every kind of element and its values, in Markdown."""
    from livlab.model.tissue.elements import ELEMENTS as KINDS

    return "\n".join(line for kind in KINDS for line in element(kind))


def element(kind: Any) -> list[str]:
    """One kind of element: what it is, and a row a value."""
    name = kind.model_fields["kind"].annotation.__args__[0]
    lines = [
        f"### `{name}`",
        "",
        str(kind.__doc__),
        "",
        "| value | unit | bounds | if not said | |",
        "|---|---|---|---|---|",
    ]
    for x in kind.parameters():
        default = "" if x.required or x.default in (None, "") else f"`{x.default}`"
        unit = "" if x.unit == "1" else x.unit
        lines.append(f"| `{x.key}` | {unit} | {x.bounds} | {default} | {x.meaning} |")
    return [*lines, ""]


def section(command: Any, name: str, level: int) -> list[str]:
    """One command, and those below it."""
    from typer import Context

    context = Context(command, info_name=name)
    children = getattr(command, "commands", {})
    usage = " ".join(command.collect_usage_pieces(context)) if not children else "COMMAND"
    lines = [f"{'#' * level} `{name}`", "", clean(command.help or ""), "", "```text", f"{name} {usage}", "```", ""]
    records = [r for p in command.get_params(context) if (r := p.get_help_record(context)) and "--help" not in r[0]]
    if records and level > 2:
        lines += ["| argument or option | does |", "|---|---|"]
        lines += [f"| `{what.replace('|', chr(92) + '|')}` | {clean(does)} |" for what, does in records] + [""]
    for child, sub in children.items():
        lines += section(sub, f"{name} {child}", 3 if level == 2 else 4)
    return lines


def clean(text: str) -> str:
    """Help text as one Markdown paragraph."""
    return html.escape(" ".join(text.split()), quote=False).replace("|", "\\|").replace("*", "\\*").replace("[", "\\[")
