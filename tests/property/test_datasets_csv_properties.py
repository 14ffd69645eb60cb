"""Whatever is in the file, the reader answers with a table or an error of livlab's own; numbers survive exactly."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from livlab.datasets.add import add
from livlab.datasets.catalogue import read_folder
from livlab.datasets.draft import read_draft
from livlab.errors import LivlabError

QUICK = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
CELL = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-(10**6), 10**6).map(str),
    st.sampled_from(
        ["", " ", "nan", "-inf", "1,5", "1.234,5", '"', '""', '"1', "1e999", "1_0", "٣", "#", "%", "wavelength"]
    ),
    st.text(max_size=6),
)
OPTIONS = st.fixed_dictionaries(
    {
        "sort": st.booleans(),
        "wavelength": st.booleans(),
        "unit": st.sampled_from([None, "1", "%", "1/cm", "?"]),
        "wavelength_unit": st.sampled_from([None, "nm", "um", "x"]),
    }
)


def attempt(content: bytes, options: dict[str, object]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "f.csv"
        file.write_bytes(content)
        try:
            draft = read_draft(file, **options)  # type: ignore[arg-type]
        except LivlabError as error:
            assert error.message
            assert error.remedy
            return
        for values in draft.columns.values():
            assert np.isfinite(values).all()
        if draft.is_spectrum:
            assert (np.diff(draft.columns["wavelength_nm"]) > 0).all()


@QUICK
@given(st.binary(max_size=400), OPTIONS)
def test_any_bytes(content: bytes, options: dict[str, object]) -> None:
    attempt(content, options)


@QUICK
@given(
    st.lists(st.lists(CELL, min_size=1, max_size=4), max_size=8),
    st.sampled_from([",", ";", "\t", "|", " "]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    OPTIONS,
)
def test_any_cells(rows: list[list[str]], delimiter: str, end: str, encoding: str, options: dict[str, object]) -> None:
    text = end.join(delimiter.join(row) for row in rows)
    attempt(text.encode(encoding, "replace"), options)


@QUICK
@given(
    st.lists(st.floats(100, 30000), min_size=2, max_size=30, unique=True),
    st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", ","), (" ", "."), ("|", ".")]),
    st.booleans(),
    st.data(),
)
def test_numbers_survive_to_the_last_bit(
    wavelengths: list[float], dialect: tuple[str, str], heading: bool, data: st.DataObject
) -> None:
    delimiter, mark = dialect
    nm = sorted({round(w, 9) for w in wavelengths})
    assume(len(nm) >= 2 and nm[-1] > 31)
    values = data.draw(st.lists(st.floats(0, 1e12), min_size=len(nm), max_size=len(nm)))
    lines = ["nm", "signal"] if heading else []
    text = (delimiter.join(lines) + "\n" if heading else "") + "".join(
        f"{w!r}{delimiter}{v!r}\n".replace(".", mark) for w, v in zip(nm, values, strict=True)
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "f.csv"
        file.write_text(text)
        draft = read_draft(file, columns=["signal:1"])
        path = add(draft, name="a", title="t", source="s", kind="assumed", into=Path(folder) / "into")
        dataset = read_folder(path)
        assert list(dataset.wavelength_nm) == nm
        assert list(dataset.column("signal")) == values
