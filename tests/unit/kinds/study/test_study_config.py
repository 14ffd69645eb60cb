"""Studies that are wrong: refused with field, value, bound and remedy, before light is followed."""

from __future__ import annotations

import pytest
from study_texts import BAND, BLOOD, MEAN, OXYGEN, READING, REFERENCE, RMSE, text

from livlab.config import builtin_experiments, load_experiment, parse_experiment, to_toml
from livlab.errors import LivlabError
from livlab.kinds.study.config_parts import Factor
from livlab.kinds.study.job import prepare


def refused(source: str, *words: str) -> None:
    """Reading or preparing it fails and says all the words."""
    with pytest.raises(LivlabError) as caught:
        prepare(parse_experiment(source, source="a.toml"))
    told = str(caught.value)
    for word in words:
        assert word in told, told
    assert caught.value.remedy


def test_bounds_that_cross_or_meet() -> None:
    refused(text("sweep", BLOOD.replace("0.01", "0.2"), MEAN), "factor blood.high", "0.1", "must be above low = 0.2")
    refused(text("sweep", BLOOD.replace("0.01", "0.1"), MEAN), "equals low = 0.1")


def test_a_logarithm_of_nothing() -> None:
    refused(text("sweep", BLOOD.replace("0.01", "0.0"), MEAN), "factor blood.low", "must be > 0 under a logarithm")


def test_unknown_parameters_get_the_nearest_known() -> None:
    refused(text("sweep", BLOOD.replace("blood.fraction", "blod.fraction"), MEAN), "blod", "Did you mean 'blood'?")
    refused(text("sweep", BLOOD.replace("blood.fraction", "blood.fractoin"), MEAN), "fractoin", "'fraction'")
    refused(text("sweep", READING.replace("parenchyma_scattering", "parenchyma_scatering"), MEAN), "scatering")
    refused(
        text("sweep", BLOOD.replace("layers.pulp.elements.blood.fraction", "instrument.angle"), MEAN), "no such field"
    )


def test_values_out_of_the_tissues_or_the_options_range() -> None:
    refused(text("sweep", OXYGEN.replace("high = 1.0", "high = 1.5"), MEAN), "oxygen", "1.5", "does not fit")
    refused(text("sweep", READING.replace('"published"', '"imagined"'), MEAN), "imagined", "does not fit")
    refused(
        text("sweep", BLOOD.replace("layers.pulp.elements.blood.fraction", "instrument.acceptance_deg")
             .replace("high = 0.1", "high = 120.0"), MEAN), "acceptance_deg", "120",
    )  # fmt: skip


def test_one_point_is_no_sweep() -> None:
    refused(text("sweep", BLOOD.replace("count = 3", "count = 1"), MEAN), "makes one point", "two values")


def test_more_jobs_than_allowed_says_how_many_and_what_to_do() -> None:
    big = text("sweep", BLOOD.replace("count = 3", "count = 60"), OXYGEN.replace("count = 2", "count = 50"), MEAN)
    refused(big, "3000 evaluations", "a grid of 60 × 50", "most_jobs = 2000", "raise most_jobs")
    refused(text("sensitivity", BLOOD, OXYGEN, MEAN, "[sensitivity]\npoints = 1024"), "4096 evaluations", "Take fewer")
    refused(text("ablation", MEAN, top="most_jobs = 5"), "evaluations (cases)", "most_jobs = 5")


def test_a_reference_shorter_than_the_band() -> None:
    band = BAND.replace("start_nm = 520", "start_nm = 460")
    refused(text("sweep", BLOOD, REFERENCE, RMSE, band=band), "reaches from 500 to 1000 nm", "band_nm = [500, 700]")


def test_too_few_wavelengths_for_a_metric() -> None:
    pearson = RMSE.replace("rmse", "pearson") + "band_nm = [600, 700]\n"
    refused(text("sweep", BLOOD, REFERENCE, pearson), "2 wavelengths", "pearson needs 3")
    refused(text("sweep", BLOOD, REFERENCE, RMSE + "band_nm = [581, 582]\n"), "0 wavelengths", "rmse needs 1")


def test_a_band_without_the_colours_that_a_colour_needs() -> None:
    refused(text("sweep", BLOOD, '[[output]]\nmetric = "lightness"\n'), "luminance")


def test_what_does_not_go_together() -> None:
    refused(text("ablation", BLOOD, MEAN), "does not go with method = 'ablation'")
    refused(text("sweep", MEAN), "needs one that varies")
    refused(text("sweep", BLOOD, MEAN, "[sensitivity]\npoints = 8"), "does not go with method = 'sweep'")
    refused(text("sensitivity", BLOOD, MEAN, "[sensitivity]\npoints = 48"), "power of 2", "Take 64")
    refused(text("sweep", BLOOD, BLOOD, MEAN), "factor", "appears twice")
    refused(text("sweep", BLOOD, RMSE), "names no reference")
    refused(text("ablation", MEAN, band=BAND.replace('"adding-doubling"\ntolerance = 1e-4', '"ledger"')), "ledger")
    refused(text("ablation", MEAN, '[ablation]\noptions = ["redirect_facto"]'), "redirect_factor")
    claim = '[[criterion]]\noutput = "mean"\nreference = 0.0\ntolerance = 1.0\n'
    refused(text("sweep", BLOOD, MEAN, claim), "does not go with method = 'sweep'")
    refused(text("ablation", MEAN, claim + 'of = "mesured"\n'), "names no case", "Did you mean 'measured'?")
    refused(text("sensitivity", BLOOD, MEAN, claim + 'statistic = "total"\nof = "blod"\n'), "names no factor")


def test_written_out_it_reads_back_the_same() -> None:
    for source in (
        text("sweep", BLOOD, READING, REFERENCE, RMSE),
        text("sensitivity", BLOOD, MEAN),
        text("ablation", MEAN, '[ablation]\ntowards = "consistent"\nbases = ["thesis"]'),
    ):
        config = parse_experiment(source)
        again = parse_experiment(to_toml(config.resolve()))
        assert again == config.resolve()
        assert again.resolve() == again


@pytest.mark.parametrize("name", ["readings", "sensitivity-liver", "sweep-liver"])
def test_livlabs_own_studies_are_sound(name: str) -> None:
    config = load_experiment(builtin_experiments()[name])
    assert config.plain()["kind"] == "study"
    assert "liver_hsi_sellner2026" in config.datasets()


def test_a_factor_meets_its_ends_and_shares_its_values_evenly() -> None:
    log = Factor(path="a", low=2.0, high=8.0, transform="log", count=3)
    assert log.grid() == pytest.approx((2.0, 4.0, 8.0))
    words = Factor(path="a", values=("x", "y", "z"))
    shares = [words.at(u) for u in (0.0, 0.33, 0.34, 0.66, 0.67, 1.0)]
    assert shares == ["x", "x", "y", "y", "z", "z"]
