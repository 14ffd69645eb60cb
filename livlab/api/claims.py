"""The claims of a run, as a notebook shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from livlab.core import markup
from livlab.criteria import COLUMNS, GROUPS, VERDICTS, Claim, format_with_error, group_title

if TYPE_CHECKING:
    import pandas as pd

    from livlab.criteria import Group


class Claims(tuple[Claim, ...]):
    """Claims in the order of the experiment.

    >>> found = Claims([Claim.of("rmse a vs b", 0.01, 0.001, 0.0, 0.1), Claim.missing("pearson a vs c", "no table")])
    >>> found
    <2 claims: 1 PASS, 1 MISSING>
    >>> found.of("rmse a vs b").verdict
    'PASS'
    """

    __slots__ = ()

    @property
    def passed(self) -> Claims:
        """Those that PASS."""
        return self._those("PASS")

    @property
    def failed(self) -> Claims:
        """Those that FAIL."""
        return self._those("FAIL")

    @property
    def too_close(self) -> Claims:
        """Those that are TOO CLOSE to a limit; `needs` of each says how many times the samples would settle it."""
        return self._those("TOO CLOSE")

    @property
    def missing(self) -> Claims:
        """Those that are MISSING."""
        return self._those("MISSING")

    def group(self, name: Group) -> Claims:
        """Those of a group: "reproduces" (the thesis), "agrees" (with a measurement) or "checks" (livlab's own).

        Raises
        ------
        InputError
            There is no such group.
        """
        from livlab.errors import InputError

        if name not in GROUPS:
            raise InputError.of("group", name, "is none", f"There are {', '.join(GROUPS)}.")
        return Claims(claim for claim in self if claim.group == name)

    def _those(self, verdict: str) -> Claims:
        return Claims(claim for claim in self if claim.verdict == verdict)

    def of(self, criterion: str) -> Claim:
        """The claim of that name.

        Raises
        ------
        InputError
            There is none.
        """
        from livlab.config.errors import nearest
        from livlab.errors import InputError

        names = [claim.criterion for claim in self]
        if criterion not in names:
            raise InputError.of(
                "claim", criterion, "is none of this run", nearest(criterion, names) or "See to_pandas()."
            )
        return self[names.index(criterion)]

    def __repr__(self) -> str:
        counts = {v: sum(c.verdict == v for c in self) for v in VERDICTS}
        shown = ", ".join(f"{n} {verdict}" for verdict, n in counts.items() if n)
        return f"<{len(self)} claim{'' if len(self) == 1 else 's'}{': ' if shown else ''}{shown}>"

    def _repr_html_(self) -> str:
        columns, parts = ["criterion", "value", "wanted", ""], []
        tissue = "liver" if any("liver" in c.criterion for c in self) else "tissue"
        for name in GROUPS:
            own = self.group(name)
            if own:
                rows = [(c.criterion, format_with_error(c.value, c.standard_error), c.wanted, c.verdict) for c in own]
                parts.append(markup.card(group_title(name, tissue), repr(own)[1:-1], markup.table(columns, rows)))
        said = [f"{c.criterion}: {c.note}" for c in self if c.note]
        return markup.card("Claims", repr(self)[1:-1], *parts, markup.notes(said))

    def to_pandas(self) -> pd.DataFrame:
        """Index criterion; the columns of claims.csv, and note."""
        import pandas as pd

        columns = [*COLUMNS, "note"]
        return pd.DataFrame([[getattr(c, k) for k in columns] for c in self], columns=columns).set_index("criterion")
