"""The lobes of which BRDF models are summed: what each is, its parameters with bounds, and where it holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from livlab.brdf.models.codes import BECKMANN, CONDUCTOR, DIELECTRIC, GGX, MIRROR, SCHLICK, Facets
from livlab.optimise import Parameter
from livlab.units import FloatArray


class Cosines(NamedTuple):
    """Contiguous (n,) arrays n·wi, n·wo and wi·wo: all that an isotropic BRDF knows of a pair of directions."""

    i: FloatArray
    o: FloatArray
    io: FloatArray


Values = Mapping[str, float]
Kernel = Callable[[Cosines, Values, FloatArray], None]


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a lobe.

    Parameters
    ----------
    parameter
        Bounds, start and transform.
    meaning
        What it is, with its unit if it has one.
    per_channel
        Whether each colour channel has its own (albedo, reflectance) or all share one (shape).
    """

    parameter: Parameter
    meaning: str
    per_channel: bool = False

    @property
    def name(self) -> str:
        """The parameter's name."""
        return self.parameter.name


@dataclass(frozen=True)
class Lobe:
    """One term of a BRDF.

    Attributes
    ----------
    name, source
        What it is called, and where it is published.
    parameters
        All of them, the scale included.
    kernel
        Fills the values in 1/sr for a scale of 1.
    scale
        Parameter that multiplies the lobe, or None.
    square
        Kernel of a further term that goes with the square of the scale (Oren–Nayar's interreflection), or None.
    quick
        Makes a kernel for searches, within 1e-3, from the values that stay and the bounds of alpha; or None.
    reciprocal
        Whether swapping wi and wo changes nothing.
    domain
        Where it may be used, in words.
    base
        Name before a suffix was added by `renamed`.
    """

    name: str
    source: str
    parameters: tuple[ModelParameter, ...]
    kernel: Kernel
    scale: str | None
    domain: str
    reciprocal: bool = True
    square: Kernel | None = None
    quick: Callable[[Values, float, float], Kernel] | None = None
    renames: Mapping[str, str] = field(default_factory=dict)

    def renamed(self, suffix: str) -> Lobe:
        """The same lobe with a suffix on each parameter, so that two of a kind stand in one sum."""
        names = {p.name: p.name + suffix for p in self.parameters}
        parameters = tuple(replace(p, parameter=_further(p.parameter, names[p.name])) for p in self.parameters)
        return replace(
            self,
            parameters=parameters,
            scale=None if self.scale is None else names[self.scale],
            renames={new: old for old, new in names.items()},
        )

    def own(self, values: Values) -> dict[str, float]:
        """The values under the names that the kernel knows."""
        return {self.renames.get(p.name, p.name): float(values[p.name]) for p in self.parameters}

    def basis(self, at: Cosines, values: Values) -> FloatArray:
        """Values (n,) in 1/sr for a scale of 1."""
        out = np.empty(at.i.size)
        self.kernel(at, self.own(values), out)
        return out

    def second(self, at: Cosines, values: Values) -> FloatArray | None:
        """Values (n,) of the term in the squared scale, or None."""
        if self.square is None:
            return None
        out = np.empty(at.i.size)
        self.square(at, self.own(values), out)
        return out


def _further(parameter: Parameter, name: str) -> Parameter:
    """A second lobe of a kind starts wider, lest the two begin as one."""
    start = parameter.start
    if start is not None and not parameter.fixed and parameter.transform == "log":
        wider = 3.0 if name.startswith("alpha") else 1.0 / 9.0 if name.startswith("exponent") else 1.0
        start = min(max(start * wider, parameter.low), parameter.high)
    return replace(parameter, name=name, start=start)


def _share(name: str, meaning: str, high: float = 1.0, start: float = 0.3) -> ModelParameter:
    return ModelParameter(Parameter(name, 0.0, high, start), meaning, per_channel=True)


KD = _share("kd", "diffuse albedo, 0 to 1")
KS = _share("ks", "scale of the lobe; 1 is the published model", 10.0, 0.5)
ALPHA = ModelParameter(
    Parameter("alpha", 0.002, 1.0, 0.15, "log"),
    "roughness of the distribution of normals, as Walter et al. 2007 define it",
)
EXPONENT = ModelParameter(Parameter("exponent", 0.5, 1e5, 60.0, "log"), "exponent of the cosine; larger is narrower")
LAFORTUNE_EXPONENT = ModelParameter(
    # With the bounds of the ratio the power stays within float64.
    Parameter("exponent", 0.5, 1500.0, 30.0, "log"),
    "exponent of the scaled dot product; larger is narrower",
)
ETA = ModelParameter(Parameter("eta", 1.01, 3.0, 1.5, "log", fixed=True), "refractive index; fixed unless freed")
CONDUCTOR_ETA = ModelParameter(
    Parameter("eta", 0.02, 10.0, 0.2, "log", fixed=True), "real refractive index; fixed unless freed", per_channel=True
)
K = ModelParameter(
    Parameter("k", 0.02, 15.0, 3.9, "log", fixed=True), "absorption index; fixed unless freed", per_channel=True
)
F0 = ModelParameter(
    Parameter("F0", 1e-4, 1.0, 0.04, "log"), "reflectance at normal incidence (Schlick)", per_channel=True
)
RS = ModelParameter(
    Parameter("Rs", 1e-4, 1.0, 0.05, "log"), "specular reflectance at normal incidence (Schlick)", per_channel=True
)
SIGMA = ModelParameter(Parameter("sigma", 0.0, 1.2, 0.3), "standard deviation of the facets' slope angle, radians")
FIXED_KS = ModelParameter(
    replace(KS.parameter, start=1.0, fixed=True), "scale of the lobe; fixed at 1 unless freed", per_channel=True
)
RATIO = ModelParameter(
    Parameter("ratio", 0.5, 2.0, 1.0, "log"), "C_z / |C_xy|: below 1 the peak lies past the mirror direction"
)

UPPER = "wi and wo above the surface; zero elsewhere"
WALTER = "Walter et al. 2007, eq. 20, 33, 34"


def _lambert(at: Cosines, _: Values, out: FloatArray) -> None:
    out[:] = np.where((at.i > 0) & (at.o > 0), 1.0 / np.pi, 0.0)


def _oren_nayar(full: bool, second: bool) -> Kernel:
    def run(at: Cosines, v: Values, out: FloatArray) -> None:
        from livlab.brdf.models.kernels import oren_nayar

        other = np.empty_like(out)
        first, twice = (other, out) if second else (out, other)
        oren_nayar(at.i, at.o, at.io, v["sigma"], full, first, twice)

    return run


def _burley(at: Cosines, v: Values, out: FloatArray) -> None:
    from livlab.brdf.models.kernels import burley

    burley(at.i, at.o, at.io, v["alpha"], out)


def _blinn_phong(classic: bool) -> Kernel:
    def run(at: Cosines, v: Values, out: FloatArray) -> None:
        from livlab.brdf.models.kernels import blinn_phong

        blinn_phong(at.i, at.o, at.io, v["exponent"], classic, out)

    return run


def _ashikhmin_shirley(at: Cosines, v: Values, out: FloatArray) -> None:
    from livlab.brdf.models.kernels import ashikhmin_shirley

    ashikhmin_shirley(at.i, at.o, at.io, v["exponent"], v["Rs"], out)


def _ashikhmin_shirley_diffuse(at: Cosines, v: Values, out: FloatArray) -> None:
    from livlab.brdf.models.kernels import ashikhmin_shirley_diffuse

    ashikhmin_shirley_diffuse(at.i, at.o, v["Rs"], out)


def _lafortune(at: Cosines, v: Values, out: FloatArray) -> None:
    from livlab.brdf.models.kernels import lafortune

    lafortune(at.i, at.o, at.io, v["ratio"], v["exponent"], out)


def _microfacet(facets: Facets, first: str = "", second: str = "") -> Kernel:
    def run(at: Cosines, v: Values, out: FloatArray) -> None:
        from livlab.brdf.models.kernels import microfacet

        f1, f2 = v.get(first, 0.0), v.get(second, 0.0)
        microfacet(at.i, at.o, at.io, v["alpha"], facets, f1, f2, out)

    return run


def _plastic_base(distribution: int) -> Kernel:
    def run(at: Cosines, v: Values, out: FloatArray) -> None:
        from livlab.brdf.models.coating import coating
        from livlab.brdf.models.kernels import table_product

        table, inside = coating(v["alpha"], v["eta"], distribution)
        table_product(at.i, at.o, table, 1.0 / (np.pi * v["eta"] ** 2 * (1.0 - inside)), out)

    return run


def _quick_plastic_base(distribution: int) -> Callable[[Values, float, float], Kernel]:
    def prepare(held: Values, low: float, high: float) -> Kernel:
        from livlab.brdf.models.coating import quick_coating, quick_value
        from livlab.brdf.models.kernels import table_product

        coefficients = quick_coating(held["eta"], distribution, low, high)

        def run(at: Cosines, v: Values, out: FloatArray) -> None:
            table, inside = quick_value(coefficients, v["alpha"], low, high)
            table_product(at.i, at.o, table, 1.0 / (np.pi * v["eta"] ** 2 * (1.0 - inside)), out)

        return run

    return prepare


def _facets() -> list[Lobe]:
    """Microfacet lobes: two distributions, four Fresnel terms, and for GGX the height-correlated shadowing."""
    terms = {
        "": (DIELECTRIC, "eta", "", (KS, ALPHA, ETA), "clear dielectric in air"),
        "-mirror": (MIRROR, "", "", (KS, ALPHA), "reflectance that does not depend on the angle"),
        "-conductor": (CONDUCTOR, "eta", "k", (KS, ALPHA, CONDUCTOR_ETA, K), "metal of index eta + ik in air"),
        "-schlick": (SCHLICK, "F0", "", (FIXED_KS, ALPHA, F0), "Schlick's Fresnel term, within 1 % for F0 below 0.1"),
    }
    found = []
    for distribution, code in (("ggx", GGX), ("beckmann", BECKMANN)):
        for ending, (fresnel, first, second, parameters, domain) in terms.items():
            found.append(
                Lobe(
                    f"{distribution}{ending}",
                    WALTER if code == GGX else "Cook & Torrance 1982; Walter et al. 2007, eq. 20, 25, 27",
                    parameters,
                    _microfacet(Facets(code, fresnel), first, second),
                    "ks",
                    f"{domain}; single scattering: loses energy as alpha nears 1; {UPPER}",
                )
            )
    found.append(
        Lobe(
            "ggx-correlated",
            "Heitz 2014, eq. 99",
            (KS, ALPHA, ETA),
            _microfacet(Facets(GGX, DIELECTRIC, correlated=True), "eta"),
            "ks",
            f"clear dielectric in air, shadowing and masking correlated by height; {UPPER}",
        )
    )
    return found


LOBES: dict[str, Lobe] = {
    lobe.name: lobe
    for lobe in (
        Lobe("lambert", "Lambert 1760", (KD,), _lambert, "kd", f"matt surfaces; {UPPER}"),
        Lobe(
            "oren-nayar",
            "Oren & Nayar 1994, eq. 25–27",
            (KD, SIGMA),
            _oren_nayar(True, False),
            "kd",
            f"rough matt surfaces of long V-grooves, sigma to about 40°; 3 % too bright beyond 80°; {UPPER}",
            square=_oren_nayar(True, True),
        ),
        Lobe(
            "oren-nayar-qualitative",
            "Oren & Nayar 1994, eq. 30",
            (KD, SIGMA),
            _oren_nayar(False, False),
            "kd",
            f"as oren-nayar, without interreflection; {UPPER}",
        ),
        Lobe("burley", "Burley 2012; 2015", (KD, ALPHA), _burley, "kd", f"diffuse part of Disney's model; {UPPER}"),
        Lobe(
            "blinn-phong",
            "Blinn 1977; normalised by Giesen 2009",
            (KS, EXPONENT),
            _blinn_phong(False),
            "ks",
            f"ks is the albedo at normal incidence; can exceed it towards grazing; {UPPER}",
        ),
        Lobe(
            "blinn-phong-classic",
            "Blinn 1977; Nunes 2019, eq. 5.2, 5.3",
            (KS, EXPONENT),
            _blinn_phong(True),
            "ks",
            f"radiance ks (n·h)^m E, so f = ks (n·h)^m / cos θ_i: neither reciprocal nor bounded; {UPPER}",
            reciprocal=False,
        ),
        Lobe(
            "ashikhmin-shirley",
            "Ashikhmin & Shirley 2000, eq. 4; Nunes 2019, eq. 5.8",
            (EXPONENT, RS),
            _ashikhmin_shirley,
            None,
            f"glossy dielectrics; the strength is Rs; {UPPER}",
        ),
        Lobe(
            "ashikhmin-shirley-diffuse",
            "Ashikhmin & Shirley 2000, eq. 5",
            (KD, RS),
            _ashikhmin_shirley_diffuse,
            "kd",
            f"diffuse part under the lobe of the same Rs, so that the sum keeps the energy; {UPPER}",
        ),
        *_facets(),
        Lobe(
            "lafortune",
            "Lafortune et al. 1997, eq. 8",
            (KS, LAFORTUNE_EXPONENT, RATIO),
            _lafortune,
            "ks",
            f"empirical; energy is not limited; {UPPER}",
        ),
        Lobe(
            "plastic-base",
            "Jakob et al., Mitsuba 3, roughplastic",
            (KD, ALPHA, ETA),
            _plastic_base(GGX),
            "kd",
            f"diffuse base under a rough dielectric coat (GGX), with what is reflected inside; {UPPER}",
            quick=_quick_plastic_base(GGX),
        ),
        Lobe(
            "plastic-base-beckmann",
            "Jakob et al., Mitsuba 3, roughplastic",
            (KD, ALPHA, ETA),
            _plastic_base(BECKMANN),
            "kd",
            f"the same under a Beckmann coat; {UPPER}",
            quick=_quick_plastic_base(BECKMANN),
        ),
    )
}
"""Every lobe by name."""

SUMS: dict[str, tuple[str, ...]] = {
    "ashikhmin-shirley-coupled": ("ashikhmin-shirley-diffuse", "ashikhmin-shirley"),
    "nunes-2017": ("lambert", "ashikhmin-shirley"),
    "plastic": ("plastic-base", "ggx"),
    "plastic-beckmann": ("plastic-base-beckmann", "beckmann"),
    "principled": ("burley", "ggx"),
}
"""Sums with a name of their own."""
