"""Recipe tables of the dispersion laws of absorbing films."""

from __future__ import annotations

from typing import Annotated, ClassVar

import pydantic

from nacre.matter.indices.laws import BrendelBormann, BSpline, CodyLorentz, Gaussian, TaucLorentz, Term
from nacre.recipe.model import RecipeModel

NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
Positive = Annotated[float, pydantic.Field(gt=0.0)]


class BandSpec(RecipeModel):
    """One band above a gap: amplitude, resonance and damping, energies in eV."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude_ev = 100, resonance_ev = 4.0, damping_ev = 1.8}",)

    amplitude_ev: NotNegative = pydantic.Field(description="strength A of the band, in eV", examples=[100])
    resonance_ev: Positive = pydantic.Field(description="energy of the resonance, in eV", examples=[4.0])
    damping_ev: Positive = pydantic.Field(description="width of the resonance, in eV", examples=[1.8])


class TaucLorentzSpec(RecipeModel):
    """Tauc-Lorentz bands (Jellison & Modine 1996) with one gap, on a constant `eps_inf`."""

    forms: ClassVar[tuple[str, ...]] = (
        "{gap_ev = 1.6, oscillators = [{amplitude_ev = 100, resonance_ev = 4.0, damping_ev = 1.8}]}",
    )

    gap_ev: NotNegative = pydantic.Field(description="gap, below which nothing is absorbed, in eV", examples=[1.6])
    oscillators: tuple[BandSpec, ...] = pydantic.Field(min_length=1, max_length=20, description="the bands")
    eps_inf: Positive = pydantic.Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        return tuple(TaucLorentz(b.amplitude_ev, b.resonance_ev, b.damping_ev, self.gap_ev) for b in self.oscillators)


class CodyLorentzSpec(RecipeModel):
    """Cody-Lorentz bands (Ferlauto et al. 2002) with one gap and an Urbach tail, on a constant `eps_inf`."""

    forms: ClassVar[tuple[str, ...]] = (
        "{gap_ev = 1.6, transition_ev = 1, oscillators = [{amplitude_ev = 80, resonance_ev = 4, damping_ev = 1.8}]}",
    )

    gap_ev: NotNegative = pydantic.Field(description="gap, in eV", examples=[1.6])
    transition_ev: Positive = pydantic.Field(
        description="energy above the gap at which Lorentzian absorption takes over, in eV", examples=[1.0]
    )
    tail_start_ev: NotNegative = pydantic.Field(
        default=0.0, description="energy below which absorption falls exponentially, in eV; 0: no tail", examples=[1.8]
    )
    tail_ev: Positive = pydantic.Field(default=0.05, description="Urbach energy of the tail, in eV")
    oscillators: tuple[BandSpec, ...] = pydantic.Field(min_length=1, max_length=20, description="the bands")
    eps_inf: Positive = pydantic.Field(default=1.0, description="permittivity of the background")

    @pydantic.model_validator(mode="after")
    def _tail_above_gap(self) -> CodyLorentzSpec:
        if 0.0 < self.tail_start_ev <= self.gap_ev:
            raise ValueError(f"tail_start_ev = {self.tail_start_ev:g} must be above gap_ev = {self.gap_ev:g}, or 0")
        return self

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        tail = (self.gap_ev, self.transition_ev, self.tail_start_ev, self.tail_ev)
        return tuple(CodyLorentz(b.amplitude_ev, b.resonance_ev, b.damping_ev, *tail) for b in self.oscillators)


class PeakSpec(RecipeModel):
    """One Gaussian band: height of the imaginary permittivity, energy, full width at half maximum."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude = 2.0, resonance_ev = 3.0, width_ev = 0.4}",)

    amplitude: NotNegative = pydantic.Field(description="height of the imaginary permittivity", examples=[2.0])
    resonance_ev: Positive = pydantic.Field(description="energy of the band, in eV", examples=[3.0])
    width_ev: Positive = pydantic.Field(description="full width at half maximum, in eV", examples=[0.4])


class GaussianSpec(RecipeModel):
    """Gaussian absorption bands with their Kramers-Kronig partner, on a constant `eps_inf`."""

    forms: ClassVar[tuple[str, ...]] = (
        "{eps_inf = 2.2, oscillators = [{amplitude = 2.0, resonance_ev = 3.0, width_ev = 0.4}]}",
    )

    oscillators: tuple[PeakSpec, ...] = pydantic.Field(min_length=1, max_length=50, description="the bands")
    eps_inf: Positive = pydantic.Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the bands."""
        return tuple(Gaussian(b.amplitude, b.resonance_ev, b.width_ev) for b in self.oscillators)


class SpreadOscillatorSpec(RecipeModel):
    """One Lorentz oscillator whose resonance is spread by a Gaussian."""

    forms: ClassVar[tuple[str, ...]] = ("{strength = 0.5, resonance_ev = 2.5, damping_ev = 0.2, spread_ev = 0.3}",)

    strength: NotNegative = pydantic.Field(
        description="oscillator strength: its contribution to the static permittivity", examples=[0.5]
    )
    resonance_ev: Positive = pydantic.Field(description="mean energy of the resonance, in eV", examples=[2.5])
    damping_ev: NotNegative = pydantic.Field(default=0.0, description="width of the resonance, in eV", examples=[0.2])
    spread_ev: Positive = pydantic.Field(description="standard deviation of the resonance, in eV", examples=[0.3])


class BrendelBormannSpec(RecipeModel):
    """Brendel-Bormann oscillators on a constant `eps_inf`."""

    forms: ClassVar[tuple[str, ...]] = (
        "{oscillators = [{strength = 0.5, resonance_ev = 2.5, damping_ev = 0.2, spread_ev = 0.3}]}",
    )

    oscillators: tuple[SpreadOscillatorSpec, ...] = pydantic.Field(
        min_length=1, max_length=50, description="the oscillators"
    )
    eps_inf: Positive = pydantic.Field(default=1.0, description="permittivity of the background")

    def terms(self) -> tuple[Term, ...]:
        """Return the oscillators."""
        return tuple(BrendelBormann(b.strength, b.resonance_ev, b.damping_ev, b.spread_ev) for b in self.oscillators)


class BSplineSpec(RecipeModel):
    """Imaginary permittivity as a cubic B-spline over energy; the real part follows by Kramers-Kronig."""

    forms: ClassVar[tuple[str, ...]] = (
        "{knots_ev = [2.5, 3.5, 4.5, 5.5, 6.5], values = [0, 0.1, 1.2, 2.0, 1.0], eps_inf = 1.5}",
    )

    knots_ev: tuple[Positive, ...] = pydantic.Field(
        min_length=4,
        max_length=200,
        description="ascending energies of the knots, in eV",
        examples=[[2.5, 3.5, 4.5, 5.5]],
    )
    values: tuple[NotNegative, ...] = pydantic.Field(
        min_length=4,
        max_length=200,
        description="coefficients of the spline at the knots",
        examples=[[0, 0.1, 1.2, 2.0]],
    )
    eps_inf: Positive = pydantic.Field(default=1.0, description="permittivity of the background")

    @pydantic.model_validator(mode="after")
    def _fits(self) -> BSplineSpec:
        if len(self.knots_ev) != len(self.values):
            raise ValueError(f"has {len(self.knots_ev)} knots_ev and {len(self.values)} values; give one value a knot")
        if any(b <= a for a, b in zip(self.knots_ev[:-1], self.knots_ev[1:])):
            raise ValueError("knots_ev must ascend")
        if self.knots_ev[0] <= 2.0 * (self.knots_ev[1] - self.knots_ev[0]):
            raise ValueError("knots_ev[0] must exceed twice the first spacing: the spline ends there, above 0 eV")
        return self

    def terms(self) -> tuple[Term, ...]:
        """Return the spline."""
        return (BSpline(self.knots_ev, self.values),)


class UrbachSpec(RecipeModel):
    """An exponential edge beside a formula of n: k = amplitude exp((E - edge) / energy)."""

    forms: ClassVar[tuple[str, ...]] = ("{amplitude = 0.1, energy_ev = 0.15, edge_ev = 3.4}",)

    amplitude: NotNegative = pydantic.Field(description="k at the edge", examples=[0.1])
    energy_ev: Positive = pydantic.Field(description="Urbach energy: k grows by e over it, in eV", examples=[0.15])
    edge_ev: Positive = pydantic.Field(description="photon energy of the edge, in eV", examples=[3.4])
