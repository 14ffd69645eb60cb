"""The claims of a run, as a notebook shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from livlab.core import markup
from livlab.criteria import COLUMNS, Claim, format_value, format_with_error

if TYPE_CHECKING:
    import pandas as pd


class Claims(tuple[Claim, ...]):
    """Claims in the order of the experiment.

    >>> found = Claims([Claim.of("rmse a vs b", 0.01, 0.001, 0.0, 0.1), Claim.missing("pearson a vs c", "no table")])
    >>> found
    <2 claims: 1 PASS, 1 MISSING>
    >>> found.of("rmse a vs b").verdict
    'PASS'
    """

    __slots__ = ()

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
        counts = {v: sum(c.verdict == v for c in self) for v in ("PASS", "FAIL", "MISSING")}
        shown = ", ".join(f"{n} {verdict}" for verdict, n in counts.items() if n)
        return f"<{len(self)} claim{'' if len(self) == 1 else 's'}{': ' if shown else ''}{shown}>"

    def _repr_html_(self) -> str:
        rows = [
            (
                c.criterion,
                format_with_error(c.value, c.standard_error),
                "–" if c.reference is None else f"{format_value(c.reference)} ± {format_value(c.tolerance)}",
                c.verdict,
            )
            for c in self
        ]
        said = [f"{c.criterion}: {c.note}" for c in self if c.note]
        columns = ["criterion", "value", "wanted", ""]
        return markup.card("Claims", repr(self)[1:-1], markup.table(columns, rows), markup.notes(said))

    def to_pandas(self) -> pd.DataFrame:
        """Index criterion; the columns of claims.csv, and note."""
        import pandas as pd

        columns = [*COLUMNS, "note"]
        return pd.DataFrame([[getattr(c, k) for k in columns] for c in self], columns=columns).set_index("criterion")
