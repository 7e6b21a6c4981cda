"""Recipe form of a material: a name, a number, a formula, a file, or a database entry."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import size_of
from nacre.matter.indices.constant import (
    BY_NAME,
    OpticalConstant,
    database_index,
    find_default,
    named_constant,
    names_file,
    unknown_material,
)
from nacre.matter.indices.database import find_page, read_page
from nacre.matter.indices.laws import (
    FRACTION_ERROR,
    SPHERE,
    BrendelBormann,
    BSpline,
    CodyLorentz,
    DrudeLorentz,
    Gaussian,
    Mixture,
    SumOfTerms,
    Tail,
    TaucLorentz,
    Term,
)
from nacre.matter.indices.models import Cauchy, Constant, Dispersion, Oscillators, Sellmeier, Table, abbe_cauchy
from nacre.matter.stack.inputs import CLEAR_K
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file
from nacre.recipe.model import NotNegative, Positive, RecipeContext, RecipeModel, UnitNumber, show_value, validate

LAWS = ("tauc_lorentz", "cody_lorentz", "gaussian", "brendel_bormann", "b_spline")
SUMMED = ("drude", "lorentz", *LAWS)  # terms of one permittivity, which may be combined
FORMS = ("name", "n", "cauchy", "sellmeier", "n_d", *SUMMED, "file", "rii", "mix")
WITH_URBACH = ("n", "cauchy", "sellmeier", "n_d")
OF_A_MIXTURE = ("volume_fractions", "model", "depolarisation")
ANISOTROPIC = ("principal", "ordinary", "extraordinary")
EXAMPLES = (
    '"Ag", {n = 1.5}, {n = 1.5, k = 0.1}, {cauchy = [1.5, 0.005]}, {file = "nk.csv"} or {rii = "main/Ag/Johnson"}'
)
FILE_KEYS = ("columns", "ignore", "unit", "spectrum")
PAGE_SUFFIXES = (".yml", ".yaml")
PROBE_NM = (360.0, 550.0, 830.0)
AMBIENT_CHECK_NM = (450.0, 550.0, 650.0)
SAME_INDEX = 2e-3  # an interface with a smaller index difference reflects less than 1e-6 of the light


class DrudeSpec(RecipeModel):
    """Free carriers: eps = eps_inf - plasma^2 / (E^2 + i E damping), energies in eV."""

    forms: ClassVar[tuple[str, ...]] = ("{plasma_ev = 9.0, damping_ev = 0.07, eps_inf = 4.0}",)

    plasma_ev: Positive = Field(description="plasma energy of the free carriers, in eV", examples=[9.0])
    damping_ev: NotNegative = Field(
        default=0.0, description="collision energy of the free carriers, in eV", examples=[0.07]
    )
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background", examples=[4.0])


class OscillatorSpec(RecipeModel):
    """One bound oscillator: strength resonance^2 / (resonance^2 - E^2 - i E damping), energies in eV."""

    forms: ClassVar[tuple[str, ...]] = ("{strength = 0.05, resonance_ev = 2.2, damping_ev = 0.3}",)

    strength: NotNegative = Field(
        description="oscillator strength: its contribution to the static permittivity", examples=[0.05]
    )
    resonance_ev: Positive = Field(description="energy of the resonance, in eV", examples=[2.2])
    damping_ev: NotNegative = Field(default=0.0, description="width of the resonance, in eV", examples=[0.3])


class LorentzSpec(RecipeModel):
    """Bound oscillators on a constant background `eps_inf`; if `drude` is also given, leave its `eps_inf` at 1."""

    oscillators: tuple[OscillatorSpec, ...] = Field(
        min_length=1, max_length=50, description="the bound oscillators, a list of tables"
    )
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")


class IndexSpec(RecipeModel):
    """Recipe form of a material: a name, a number, a formula, a file, or a database entry.

    A bare string is a name, a bare number an index. A table gives exactly one of these: `name`; `n` (with
    `k`); `cauchy = [c0, c1, ...]`, n = c0 + c1/l^2 + c2/l^4...; `sellmeier = [b1, c1, b2, c2, ...]`,
    n^2 = 1 + sum b l^2/(l^2 - c); `n_d` with `abbe`; one or more of `drude`, `lorentz`, `tauc_lorentz`,
    `cody_lorentz`, `gaussian`, `brendel_bormann` and `b_spline`, whose permittivities add; `file`, a text table; `rii`,
    a refractiveindex.info entry; `mix`, an effective medium. Wavelengths l in um. `extrapolate = "edge"` continues the
    end values outside the published range.
    """

    noun: ClassVar[str] = "optical constant"
    one_of: ClassVar[tuple[str, ...]] = (
        "name", "n", "cauchy", "sellmeier", "n_d", "|".join(SUMMED), "file", "rii", "mix",
    )  # fmt: skip
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = (
        {"enum": list(BY_NAME)},
        {"type": "string", "description": "a named optical constant, or shelf/book/page of refractiveindex.info"},
        {"type": "number", "minimum": 0, "description": "a constant index"},
    )

    name: str | None = Field(
        default=None,
        description="a named optical constant, see `nacre indices search`; written alone it needs no table",
        examples=["SiO2"],
    )
    n: NotNegative | None = Field(
        default=None, description="a constant refractive index; written alone it needs no table", examples=[1.5]
    )
    k: float | None = Field(
        json_schema_extra={"minimum": 0},
        default=None,
        description="the extinction coefficient beside n; waves decay for k > 0",
        examples=[0.06],
    )
    cauchy: tuple[float, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=10,
        description="coefficients c0, c1, ... of n = c0 + c1/l^2 + c2/l^4 ..., wavelength l in um",
        examples=[[1.45, 0.004]],
    )
    sellmeier: tuple[float, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=20,
        description="pairs b1, c1, b2, c2, ... of n^2 = 1 + sum b l^2/(l^2 - c), wavelength l in um",
        examples=[[1.0396, 0.006, 0.2318, 0.02]],
    )
    n_d: Positive | None = Field(
        default=None,
        description="refractive index at the d line (587.6 nm), with the Abbe number beside it",
        examples=[1.575],
    )
    abbe: Positive | None = Field(default=None, description="Abbe number beside n_d", examples=[30])
    drude: DrudeSpec | None = Field(default=None, description="free carriers, alone or beside lorentz")
    lorentz: LorentzSpec | None = Field(default=None, description="bound oscillators, alone or beside drude")
    tauc_lorentz: TaucLorentzSpec | None = Field(default=None, description="bands above a gap, by Tauc")
    cody_lorentz: CodyLorentzSpec | None = Field(default=None, description="bands above a gap, by Cody")
    gaussian: GaussianSpec | None = Field(default=None, description="Gaussian absorption bands")
    brendel_bormann: BrendelBormannSpec | None = Field(
        default=None, description="oscillators with a Gaussian spread of the resonance"
    )
    b_spline: BSplineSpec | None = Field(
        default=None, description="imaginary permittivity as a spline, the real part by Kramers-Kronig"
    )
    urbach: UrbachSpec | None = Field(
        default=None, description="an exponential absorption edge beside n, cauchy, sellmeier or n_d"
    )
    mix: tuple[IndexSpec, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=10,
        description="materials mixed far below the wavelength; of maxwell-garnett the first is the host",
        examples=[["TiO2", "air"]],
    )
    volume_fractions: tuple[UnitNumber, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=10,
        description="volume fractions of the mixed materials, in sum 1; the last may be left out and fills the rest",
        examples=[[0.8, 0.2]],
    )
    model: Literal["bruggeman", "maxwell-garnett", "looyenga", "lichtenecker"] | None = Field(
        default=None, description="effective-medium model of the mixture; default: bruggeman", examples=["bruggeman"]
    )
    depolarisation: UnitNumber | Annotated[tuple[UnitNumber, ...], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="depolarisation factors of randomly oriented ellipsoids, three in sum 1, or one factor of aligned "
        "ellipsoids along the field; default: spheres, 1/3",
        examples=[[0.2, 0.4, 0.4], 0.5],
    )
    file: str | None = Field(
        default=None,
        description="a file beside the recipe with n and k, or e1 and e2, over wavelength or energy: a text table, or "
        "a file of WVASE, Zemax, Mitsuba, or refractiveindex.info (.yml)",
        examples=["nk.csv"],
    )
    rii: str | None = Field(
        default=None,
        description="an entry of the refractiveindex.info database: shelf/book/page",
        examples=["main/Ag/Johnson"],
    )
    columns: tuple[str, ...] = Field(
        default=(),
        description='beside file: names of its columns if headings are missing; "-" leaves one out',
        examples=[["energy_eV", "e1", "e2"]],
    )
    ignore: tuple[str, ...] = Field(
        default=(), description="beside file: headings of columns that are left out", examples=[["batch"]]
    )
    unit: str | None = Field(
        default=None, description="beside file: unit of its wavelengths or energies, if it lacks one", examples=["um"]
    )
    spectrum: str | None = Field(
        default=None, description="beside file: name or number of one of its materials", examples=["SIO2"]
    )
    extrapolate: Literal["error", "edge"] = Field(
        default="error", description="outside the tabulated range: an error, or the end values"
    )

    _built: OpticalConstant = pydantic.PrivateAttr()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_bare_values(cls, data: Any) -> Any:
        if isinstance(data, str):
            return {"name": data}
        if isinstance(data, int | float) and not isinstance(data, bool):
            return {"n": data}
        if not isinstance(data, Mapping | IndexSpec):
            raise ValueError(f"= {show_value(data)} is not a material; write {EXAMPLES}")
        if isinstance(data, Mapping) and any(key in data for key in ANISOTROPIC):
            raise ValueError(
                "= {" + ", ".join(f"{key} = ..." for key in data if key in ANISOTROPIC) + "} is anisotropic; "
                "anisotropic media may be layers and the substrate of a film, and nothing else"
            )
        return data

    def model_post_init(self, context: Any) -> None:
        """Build during validation: the recipe's folder is known and errors carry the key."""
        context = (context or {}).get("recipe") or RecipeContext()
        self._check_form()
        try:
            self._built = self._make(context)
            self._probe()
        except NacreError as error:
            raise ValueError(_after_key(error, self)) from None

    def build(self, context: RecipeContext | None = None) -> OpticalConstant:
        """Return the optical constant built during validation."""
        return self._built

    def _check_form(self) -> None:
        forms = [form for form in FORMS if getattr(self, form) is not None]
        if not forms or (len(forms) > 1 and not set(forms) <= set(SUMMED)):
            got = " and ".join(forms) if forms else "nothing"
            raise ValueError(f"gives {got}; a material is exactly one of {EXAMPLES}")
        if self.k is not None:
            if self.n is None:
                raise ValueError(f".k = {self.k:g} needs n beside it")
            if self.k < 0.0:
                raise ValueError(f".k = {self.k:g} is not allowed; nacre takes n + ik with k >= 0")
        beside = next((key for key in FILE_KEYS if getattr(self, key) not in (None, ())), None)
        if beside is not None and self.file is None:
            raise ValueError(f".{beside} = {show_value(getattr(self, beside))} needs file beside it")
        if (self.n_d is None) != (self.abbe is None):
            raise ValueError("needs both n_d and abbe")
        if self.sellmeier is not None and len(self.sellmeier) % 2:
            raise ValueError(f".sellmeier has {len(self.sellmeier)} numbers; they come in pairs b, c")
        backgrounds = [form for form in forms if form in SUMMED and getattr(self, form).eps_inf != 1.0]
        if len(backgrounds) > 1:
            raise ValueError(f"gives eps_inf twice, in {backgrounds[0]} and in {backgrounds[1]}; delete one")
        if self.urbach is not None and forms[0] not in WITH_URBACH:
            raise ValueError(f".urbach stands beside {', '.join(WITH_URBACH)}, not beside {forms[0]}")
        self._check_mixture()

    def _check_mixture(self) -> None:
        if self.mix is None:
            stray = next((key for key in OF_A_MIXTURE if getattr(self, key) is not None), None)
            if stray is not None:
                raise ValueError(f".{stray} belongs to a mixture; add mix = [...]")
            return
        fractions, count = self.volume_fractions, len(self.mix)
        if fractions is None or len(fractions) not in (count, count - 1):
            got = "no volume_fractions" if fractions is None else f"{len(fractions)} volume_fractions"
            raise ValueError(f"mixes {count} materials with {got}; give one of each, or leave the last one out")
        total = sum(fractions)
        if total > 1.0 + FRACTION_ERROR or (len(fractions) == count and total < 1.0 - FRACTION_ERROR):
            raise ValueError(
                f".volume_fractions = {list(fractions)} have the sum {total:g}; it should be 1; leave out the last one "
                "to make it the rest"
            )
        factors = self.depolarisation
        if isinstance(factors, tuple) and abs(sum(factors) - 1.0) > FRACTION_ERROR:
            raise ValueError(f".depolarisation = {list(factors)} has the sum {sum(factors):g}; it should be 1")
        if factors is not None and self.model in ("looyenga", "lichtenecker"):
            raise ValueError(f".depolarisation has no meaning for {self.model}; use bruggeman or maxwell-garnett")

    def _make(self, context: RecipeContext) -> OpticalConstant:
        if self.name is not None:
            is_no_entry = self.name.count("/") < 2 or names_file(self.name)
            if find_default(self.name) is None and is_no_entry:
                raise NacreError(f"= {show_value(self.name)} {unknown_material(self.name)}")
            made = named_constant(self.name)
        elif self.rii is not None:
            find_page(self.rii)
            made = database_index(self.rii)
        elif self.file is not None:
            made = OpticalConstant(self.file, self._table(self.file, context), self.file)
        else:
            label, model = self._formula()
            made = OpticalConstant(label, model, "given in the recipe")
        return made.with_extrapolation(self.extrapolate)

    def _table(self, name: str, context: RecipeContext) -> Dispersion:
        from nacre.readers.constants import other_of_pair

        path = context.path(name)
        other = other_of_pair(path)
        if other is not None and other.is_file():
            context.path(str(other))  # its content is part of the material
        options = ReadOptions(
            unit=self.unit, spectrum=self.spectrum, columns=self.columns, ignore=self.ignore, expects="constants"
        )

        def read() -> Dispersion:
            return read_page(path) if path.suffix.lower() in PAGE_SUFFIXES else read_index_file(path, options)

        dispersion: Dispersion = context.once(("index", path, options), read)
        return dispersion

    def _formula(self) -> tuple[str, Dispersion]:
        if self.mix is not None:
            return self._mixture(self.mix)
        if any(getattr(self, form) is not None for form in SUMMED):
            return self._sum_of_terms()
        label, model = self._index_formula()
        if self.urbach is None:
            return label, model
        tail = Tail(model, self.urbach.amplitude, self.urbach.energy_ev, self.urbach.edge_ev)
        return f"{label} with an Urbach tail", tail

    def _index_formula(self) -> tuple[str, Dispersion]:
        if self.n is not None:
            label = f"n = {self.n:g}" + (f" + {self.k:g}i" if self.k else "")
            return label, Constant(self.n, self.k or 0.0)
        if self.cauchy is not None:
            return f"cauchy {list(self.cauchy)}", Cauchy(self.cauchy)
        if self.sellmeier is not None:
            pairs = tuple(zip(self.sellmeier[0::2], self.sellmeier[1::2]))
            return f"sellmeier {list(self.sellmeier)}", Sellmeier(pairs)
        assert self.n_d is not None and self.abbe is not None
        return f"n_d = {self.n_d:g}, abbe = {self.abbe:g}", abbe_cauchy(self.n_d, self.abbe)

    def _sum_of_terms(self) -> tuple[str, Dispersion]:
        drude, lorentz = self.drude, self.lorentz
        bound = lorentz.oscillators if lorentz else ()
        classical = Oscillators(
            eps_inf=(drude.eps_inf if drude else 1.0) * (lorentz.eps_inf if lorentz else 1.0),
            plasma_ev=drude.plasma_ev if drude else 0.0,
            damping_ev=drude.damping_ev if drude else 0.0,
            oscillators=tuple((o.strength, o.resonance_ev, o.damping_ev) for o in bound),
        )
        laws = [law for name in LAWS if (law := getattr(self, name)) is not None]
        if not laws:
            return "drude-lorentz", classical
        terms: list[Term] = [term for law in laws for term in law.terms()]
        if drude or lorentz:
            terms.append(DrudeLorentz(classical))
        eps_inf = classical.eps_inf
        for law in laws:
            eps_inf *= law.eps_inf
        return ", ".join(name for name in SUMMED if getattr(self, name) is not None), SumOfTerms(eps_inf, tuple(terms))

    def _mixture(self, mix: tuple[IndexSpec, ...]) -> tuple[str, Dispersion]:
        fractions = self.volume_fractions or ()
        if len(fractions) < len(mix):
            fractions = (*fractions, max(1.0 - sum(fractions), 0.0))
        factors = SPHERE if self.depolarisation is None else self.depolarisation
        factors = factors if isinstance(factors, tuple) else (factors,)
        parts = tuple(one.build() for one in mix)
        name = " + ".join(f"{100 * f:.4g} % {part.name}" for f, part in zip(fractions, parts, strict=True))
        return name, Mixture(parts, fractions, self.model or "bruggeman", factors)

    def _probe(self) -> None:
        """Evaluate the constant at visible wavelengths: this detects coefficients in the wrong unit."""
        low, high = self._built.range_nm
        inside = [w for w in PROBE_NM if low <= w <= high]
        self._built.n_complex(inside)


def _after_key(error: NacreError, spec: IndexSpec) -> str:
    """Return an error message that starts with its key."""
    text = str(error)
    if text.startswith("= "):
        return text
    form = next(form for form in FORMS if getattr(spec, form) is not None)
    value = getattr(spec, form)
    if form in ("rii", "file"):
        return f".{form} = {show_value(value)}: {text.removeprefix(f'{show_value(value)} ').removeprefix(f'{value}: ')}"
    return text


def ambient_in(spec: IndexSpec, is_named: bool, context: RecipeContext) -> OpticalConstant:
    """Return a recipe's ambient: its own, or the enclosing recipe's medium.

    Args:
        spec: the recipe's key `ambient`, or its default.
        is_named: whether the recipe gives it.
        context: holds the enclosing medium.

    Raises:
        RecipeError: the ambient differs from the enclosing medium, or absorbs.
    """
    own, medium = spec.build(context), context.ambient
    low, high = own.range_nm
    k = max((abs(own.n_complex([w])[0].imag) for w in AMBIENT_CHECK_NM if low <= w <= high), default=0.0)
    if medium is None and k >= CLEAR_K:
        raise context.fail(
            "ambient", own.name, f"absorbs (k = {k:.3g}): R and T are undefined in a medium in which the incoming "
            "and the returning light exchange power; use a clear ambient, and the absorbing medium as a layer",
        )  # fmt: skip
    if medium is None:
        return own
    ambient: OpticalConstant = medium
    if is_named:
        here, there = (constant.n_complex(AMBIENT_CHECK_NM).real for constant in (own, ambient))
        if max(abs(here - there)) > SAME_INDEX:
            raise context.fail(
                "ambient",
                own.name,
                f'has n = {here[1]:.4g}, but lies in "{ambient.name}" with n = {there[1]:.4g}; leave ambient out '
                "to use that medium",
            )
    return ambient


def index_spec(data: Any, context: RecipeContext | None = None) -> IndexSpec:
    """Validate one material table for `nacre.matter.index`.

    Raises:
        RecipeError: the first error, in one line.
    """
    context = context or RecipeContext(source="material")
    if isinstance(data, str):
        data = {"name": data}
    elif isinstance(data, int | float) and not isinstance(data, bool):
        data = {"n": data}
    elif not isinstance(data, Mapping):
        raise context.fail("material", data, f"is not a material; write {EXAMPLES}")
    else:
        unknown = next((key for key in data if key not in IndexSpec.model_fields), None)
        if unknown is not None:
            named = " ".join(str(unknown).split())[:40]
            raise context.fail(named, data[unknown], f"is not a key of a material.{did_you_mean(named, FORMS)}")
    made: IndexSpec = validate(IndexSpec, data, context)
    return made


MAX_BYTES = 20_000_000
FORM = 'write a header "wavelength_nm,n,k" (or wavelength_um, energy_eV) and one row of numbers per wavelength'
logger = logging.getLogger("nacre")


def read_index_file(path: Path, options: ReadOptions) -> Table:
    """Read n and k; assumptions are logged.

    Raises:
        NacreError: the file cannot be read, holds no optical constants, or several materials of which none is chosen;
            the message starts with the file's name.
    """
    try:
        constants = _constants(path, options)
    except NacreError as error:
        raise NacreError(f"{path.name}: {str(error).removeprefix(f'{path}: ')}") from None
    assumptions = "; ".join(constants.assumed + constants.left_out)
    if assumptions:
        logger.warning("%s: %s", path.name, assumptions)
    return Table.sorted(constants.data["wavelength_nm"], constants.data["n"], constants.data["k"])


def _constants(path: Path, options: ReadOptions) -> Measurement:
    if (size := size_of(path)) > MAX_BYTES:
        raise NacreError(f"{path}: is larger than {MAX_BYTES // 1_000_000} MB; is it a table of n and k?")
    if size == 0:
        raise NacreError(f"{path}: is empty: column n is missing; {FORM}")
    measurements = open_file(path, options)
    usable = [measurement for measurement in measurements if measurement.kind == "constants"]
    if not usable:
        raise NacreError(f"{path}: holds {measurements[0].kind}, neither header nor row of optical constants; {FORM}")
    if len(usable) > 1:
        names = [measurement.name or str(i + 1) for i, measurement in enumerate(usable)]
        if options.spectrum is None:
            raise AmbiguousFileError(
                f'{path}: holds {len(usable)} materials ({", ".join(names)[:200]}); name one: spectrum = "{names[0]}"',
                "spectrum",
                tuple(names),
            )
        from nacre.readers.table import chosen_block

        return usable[chosen_block(path, options.spectrum, names)]
    return usable[0]


# Recipe tables of the dispersion laws of absorbing films.


class BandSpec(RecipeModel):
    """One band above a gap: amplitude, resonance and damping, energies in eV."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude_ev = 100, resonance_ev = 4.0, damping_ev = 1.8}",)

    amplitude_ev: NotNegative = Field(description="strength A of the band, in eV", examples=[100])
    resonance_ev: Positive = Field(description="energy of the resonance, in eV", examples=[4.0])
    damping_ev: Positive = Field(description="width of the resonance, in eV", examples=[1.8])


class TaucLorentzSpec(RecipeModel):
    """Tauc-Lorentz bands (Jellison & Modine 1996) with one gap, on a constant `eps_inf`."""

    gap_ev: NotNegative = Field(description="gap, below which nothing is absorbed, in eV", examples=[1.6])
    oscillators: tuple[BandSpec, ...] = Field(min_length=1, max_length=20, description="the bands")
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        return tuple(TaucLorentz(b.amplitude_ev, b.resonance_ev, b.damping_ev, self.gap_ev) for b in self.oscillators)


class CodyLorentzSpec(RecipeModel):
    """Cody-Lorentz bands (Ferlauto et al. 2002) with one gap and an Urbach tail, on a constant `eps_inf`."""

    gap_ev: NotNegative = Field(description="gap, in eV", examples=[1.6])
    transition_ev: Positive = Field(
        description="energy above the gap at which Lorentzian absorption begins, in eV", examples=[1.0]
    )
    tail_start_ev: NotNegative = Field(
        default=0.0, description="energy below which absorption falls exponentially, in eV; 0: no tail", examples=[1.8]
    )
    tail_ev: Positive = Field(default=0.05, description="Urbach energy of the tail, in eV")
    oscillators: tuple[BandSpec, ...] = Field(min_length=1, max_length=20, description="the bands")
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")

    def model_post_init(self, _: Any) -> None:
        if 0.0 < self.tail_start_ev <= self.gap_ev:
            raise ValueError(f"tail_start_ev = {self.tail_start_ev:g} must be above gap_ev = {self.gap_ev:g}, or 0")

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        tail = (self.gap_ev, self.transition_ev, self.tail_start_ev, self.tail_ev)
        return tuple(CodyLorentz(b.amplitude_ev, b.resonance_ev, b.damping_ev, *tail) for b in self.oscillators)


class PeakSpec(RecipeModel):
    """One Gaussian band: height of the imaginary permittivity, energy, full width at half maximum."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude = 2.0, resonance_ev = 3.0, width_ev = 0.4}",)

    amplitude: NotNegative = Field(description="height of the imaginary permittivity", examples=[2.0])
    resonance_ev: Positive = Field(description="energy of the band, in eV", examples=[3.0])
    width_ev: Positive = Field(description="full width at half maximum, in eV", examples=[0.4])


class GaussianSpec(RecipeModel):
    """Gaussian absorption bands with their Kramers-Kronig partner, on a constant `eps_inf`."""

    oscillators: tuple[PeakSpec, ...] = Field(min_length=1, max_length=50, description="the bands")
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        return tuple(Gaussian(b.amplitude, b.resonance_ev, b.width_ev) for b in self.oscillators)


class SpreadOscillatorSpec(RecipeModel):
    """One Lorentz oscillator whose resonance is spread by a Gaussian."""

    forms: ClassVar[tuple[str, ...]] = ("{strength = 0.5, resonance_ev = 2.5, damping_ev = 0.2, spread_ev = 0.3}",)

    strength: NotNegative = Field(
        description="oscillator strength: its contribution to the static permittivity", examples=[0.5]
    )
    resonance_ev: Positive = Field(description="mean energy of the resonance, in eV", examples=[2.5])
    damping_ev: NotNegative = Field(default=0.0, description="width of the resonance, in eV", examples=[0.2])
    spread_ev: Positive = Field(description="standard deviation of the resonance, in eV", examples=[0.3])


class BrendelBormannSpec(RecipeModel):
    """Brendel-Bormann oscillators on a constant `eps_inf`."""

    oscillators: tuple[SpreadOscillatorSpec, ...] = Field(min_length=1, max_length=50, description="the oscillators")
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the oscillators."""
        return tuple(BrendelBormann(b.strength, b.resonance_ev, b.damping_ev, b.spread_ev) for b in self.oscillators)


class BSplineSpec(RecipeModel):
    """Imaginary permittivity as a cubic B-spline over energy; the real part follows by Kramers-Kronig."""

    knots_ev: tuple[Positive, ...] = Field(
        min_length=4,
        max_length=200,
        description="ascending energies of the knots, in eV",
        examples=[[2.5, 3.5, 4.5, 5.5]],
    )
    values: tuple[NotNegative, ...] = Field(
        min_length=4,
        max_length=200,
        description="coefficients of the spline at the knots",
        examples=[[0, 0.1, 1.2, 2.0]],
    )
    eps_inf: Positive = Field(default=1.0, description="permittivity of the background")

    def model_post_init(self, _: Any) -> None:
        if len(self.knots_ev) != len(self.values):
            raise ValueError(f"has {len(self.knots_ev)} knots_ev and {len(self.values)} values; give one value a knot")
        if any(b <= a for a, b in zip(self.knots_ev[:-1], self.knots_ev[1:])):
            raise ValueError("knots_ev must ascend")
        if self.knots_ev[0] <= 2.0 * (self.knots_ev[1] - self.knots_ev[0]):
            raise ValueError("knots_ev[0] must exceed twice the first spacing: the spline ends there, above 0 eV")

    def terms(self) -> tuple[Term, ...]:
        """Return the spline."""
        return (BSpline(self.knots_ev, self.values),)


class UrbachSpec(RecipeModel):
    """An exponential edge beside a formula of n: k = amplitude exp((E - edge) / energy)."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude = 0.1, energy_ev = 0.15, edge_ev = 3.4}",)

    amplitude: NotNegative = Field(description="k at the edge", examples=[0.1])
    energy_ev: Positive = Field(description="Urbach energy: k grows by e over it, in eV", examples=[0.15])
    edge_ev: Positive = Field(description="photon energy of the edge, in eV", examples=[3.4])
