"""Where every number that livlab brings is from, and under which terms: the page that ships with it."""

from __future__ import annotations

from collections.abc import Iterable

from livlab.datasets.catalogue import builtin_root, is_builtin, load, names

_HEAD = """\
# Licences and sources of the data

livlab's code is under the MIT licence. Its datasets are numbers from the literature; each names its source, how the
numbers came, and under which terms they are passed on. This page is written by `livlab data licences` from the
datasets' own `meta.toml`, and held against them by a test. A report cites the datasets that its run drew on.

Whoever uses a number cites its source, not livlab.
"""

_TAIL = """\
## Other numbers

- Presets of tissues (`livlab/model/tissue/preset_files`) hold single published values; each has its source beside it,
  and `assumed` where there is none.
- `livlab/stress/trusted.csv` was computed by livlab itself with many digits.
- Colour matching functions and illuminants are those of colour-science (BSD-3-Clause), which livlab does not copy.
"""


def licences_page(only: Iterable[str] | None = None) -> str:
    """The page of sources and licences as Markdown, one section a dataset.

    Parameters
    ----------
    only
        Names; every dataset of livlab's own if not given.

    Raises
    ------
    DatasetError
        One of them is missing or damaged.

    Examples
    --------
    >>> print(licences_page(["water_hale_querry1973"]).splitlines()[0])
    # Licences and sources of the data
    """
    chosen = [name for name in names(search=[builtin_root()]) if is_builtin(name)] if only is None else list(only)
    parts = [_HEAD]
    for name in chosen:
        meta = load(name).meta
        link = f"https://doi.org/{meta.doi}" if meta.doi else meta.url or ""
        rows = [
            ("source", meta.source),
            ("link", f"<{link}>" if link else ""),
            ("how", f"{meta.kind}; {meta.read_in}"),
            ("licence", meta.licence),
            ("uncertainty", meta.uncertainty.text),
            ("sha256", f"`{meta.sha256}`"),
        ]
        lines = [f"- {key}: {_plain(text)}" for key, text in rows if text]
        parts.append(f"## {name}\n\n{_plain(meta.title)}.\n\n" + "\n".join(lines) + "\n")
    return "\n".join([*parts, _TAIL])


def _plain(text: str) -> str:
    """One line, without what Markdown would take for more than text."""
    return " ".join(text.split()).replace("*", r"\*")
