"""The dossier: a static site of every claim, and of the thesis's figures and tables beside ours."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from livlab.core.files import told_plainly, write_whole
from livlab.dossier.pages import group_pages, index_page, thesis_page
from livlab.dossier.site import Site, read_site
from livlab.dossier.sure import claims_of_site, claims_table
from livlab.reports.page import ICONS


def build_dossier(out: Path) -> Path:
    """Write the site into a folder that holds the record of `livlab validate`; it needs no network and no script.

    Every page is made from the record and the run folders that it names. Each experiment's own report is copied in.

    Parameters
    ----------
    out
        The site's folder.

    Returns
    -------
    Its index.html.

    Raises
    ------
    InputError
        There is no record, or it is damaged. A damaged run is no error: it is MISSING on the pages.
    EnvironmentProblem
        The site cannot be written.
    """
    site = read_site(out)
    with told_plainly(out):
        for name in ("experiments", "images"):
            shutil.rmtree(out / name, ignore_errors=True)
            (out / name).mkdir(parents=True)
        for stale in out.glob("*.html"):
            stale.unlink()
    _copy_reports(site)
    write_whole(out / "claims.csv", claims_table(claims_of_site(site)))
    pages = [thesis_page(site), *group_pages(site)]
    pages = [index_page(site, pages), *pages]
    environment = Environment(
        loader=PackageLoader("livlab.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = environment.get_template("dossier.html.j2")
    css = "".join(
        files("livlab.reports").joinpath(f"templates/{name}.css").read_text(encoding="utf-8")
        for name in ("style", "dossier")
    )
    for page in pages:
        text = template.render(
            page=page,
            pages=[(p.name, p.short) for p in pages],
            site_title=str(site.dossier["title"]),
            css=Markup(css),
            icons=ICONS,
            version=str(site.record["livlab"]),
            made=str(site.record["made"]),
        )
        write_whole(out / f"{page.name}.html", text)
    return out / "index.html"


def _copy_reports(site: Site) -> None:
    """Each experiment's report, with a way back; one that is not there is built from its folder."""
    from livlab.kinds.report import build_report

    for e in site.entries:
        if e.run is None:
            continue
        source = e.run.path / "report.html"
        text = (source if source.is_file() else build_report(e.run.path)).read_text(encoding="utf-8")
        back = f'<p class="kicker"><a href="../{e.group}.html">{Markup.escape(site.dossier["title"])}</a></p>'
        text = text.replace('<header class="page">', f'<header class="page">\n  {back}', 1)
        write_whole(site.out / e.report, text)


__all__ = ["build_dossier"]
