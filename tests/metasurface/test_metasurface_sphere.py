"""One sphere on a stack: against another code, reciprocity, energy, the choice of its order."""

import numpy as np
import pytest
from helpers_metasurface import reference, sphere, surface, t_matrix
from validation._metasurface_helpers import cross_sections

from nacre.families.metasurface.tmatrix.particle_on_stack import (
    MultipoleConvergenceError,
    amplitude,
    choose_order,
    reflection_operator,
)
from nacre.matter.mie import mie_coefficients, mie_efficiencies

SMUTHI_BAR = 2e-5
EXTINCTION_BAR = 1e-4
RECIPROCITY_BAR = 1e-12
ORDER_BAR = 1e-3


def _case(data, i):
    films = [(complex(data["n_film"]), float(data["film_h_nm"][i]))] if data["film_h_nm"][i] > 0 else []
    return sphere(
        float(data["wavelength_nm"][i]), float(data["radius_nm"][i]), data["n_sphere"][i], data["n_substrate"][i],
        films, lmax=int(data["lmax"]), gap=float(data["gap_nm"][i]), mmax=int(data["mmax"]),
    )  # fmt: skip


def test_far_field_and_extinction_agree_with_smuthi():
    data = reference("sphere_on_stack.npz")
    for i in range(len(data["wavelength_nm"])):
        ours, pol = _case(data, i), int(data["pol_in"][i])
        cos_i = [np.cos(np.radians(data["theta_i_deg"][i]))]
        f = amplitude(
            ours.harmonics(ours.directions(np.cos(data["theta_s_rad"])), ours.directions(cos_i)), data["phi_rad"]
        )
        power, truth = np.abs(f[:, :, pol, 0]) ** 2 * 1e-6, data["dsigma_um2_per_sr"][i]
        assert np.linalg.norm(power - truth) <= SMUTHI_BAR * np.linalg.norm(truth), i
        found = cross_sections(ours, cos_i)
        assert abs(found.extinction_reflected[pol, 0] * 1e-6 / data["ext_reflection_um2"][i] - 1) <= EXTINCTION_BAR
        if np.isfinite(data["ext_transmission_um2"][i]):
            ratio = found.extinction_transmitted[pol, 0] * 1e-6 / data["ext_transmission_um2"][i]
            assert abs(ratio - 1) <= EXTINCTION_BAR


@pytest.mark.parametrize("substrate", [1.5, 4.3 + 0.07j])
def test_single_sphere_is_reciprocal(substrate):
    ours = sphere(500.0, 90.0, 0.05 + 3.13j, substrate, [(1.46, 300.0)], lmax=15)
    sides = [ours.directions(np.cos([0.1, 0.7, 1.3]))]
    if substrate == 1.5:
        sides.append(ours.directions(np.cos([0.2, 0.8, 1.4]), below=True))
    for a in sides:
        for b in sides:
            there = np.abs(ours.harmonics(a, b)) ** 2
            back = np.abs(ours.harmonics(b, a)) ** 2
            assert np.abs(there - back.transpose(0, 3, 4, 1, 2)).max() <= RECIPROCITY_BAR * there.max()


def test_lossless_sphere_on_glass_scatters_all_it_extinguishes():
    ours = sphere(600.0, 75.0, 3.94, 1.5, lmax=8)
    for below in (False, True):
        found = cross_sections(ours, np.cos([0.0, 0.5, 1.0, 1.45]), below)
        assert np.abs(found.absorption / found.extinction).max() <= EXTINCTION_BAR


def test_sphere_without_a_stack_is_a_mie_sphere():
    ours = sphere(600.0, 75.0, 3.94 + 0.1j, 1.0, lmax=8, mmax=8)
    x = ours.surface.wavenumber * 75.0
    mie = mie_efficiencies(*mie_coefficients(8, [x], [3.94 + 0.1j]), x)
    found = cross_sections(ours, np.cos([0.0, 0.8, 1.4]))
    area = np.pi * 75.0**2
    assert np.abs(found.extinction / area / mie.extinction - 1).max() < 1e-10
    assert np.abs(found.absorption / area / mie.absorption - 1).max() < 1e-9


@pytest.mark.parametrize("films", [(), ((2.3, 80.0),), ((2.3, 80.0), (1.38, 130.0), (1.9, 40.0))])
def test_a_clear_stack_reflects_alike_from_both_sides(films):
    """Stokes: |r| and the power that passes are the same from either side of films that absorb nothing."""
    below = surface(500.0, 1.5, films)
    cos_above = np.array([1.0, 0.8, 0.3])
    cos_below = np.sqrt(1 - (1 - cos_above**2) / 1.5**2)
    back, through = below.from_below(cos_below)
    np.testing.assert_allclose(np.abs(back), np.abs(below.reflection(cos_above)), rtol=1e-12)
    passed = cos_above / (1.5 * cos_below) * np.abs(through) ** 2
    np.testing.assert_allclose(np.abs(back) ** 2 + passed, 1.0, rtol=1e-12)


def test_far_away_stack_is_met_by_the_incident_and_reflected_wave_only():
    """At a great height the operator vanishes as the reflected spherical wave does."""
    near = np.abs(reflection_operator(surface(500.0, 1.5), 90.0, 2, 2)).max()
    far = np.abs(reflection_operator(surface(500.0, 1.5), 9e4, 2, 2)).max()
    assert far < 2e-3 * near


def test_reflection_operator_is_converged_in_its_nodes():
    below = surface(500.0, 4.3 + 0.07j, [(1.46, 600.0)])
    default, fine = reflection_operator(below, 90.0, 10, 4), reflection_operator(below, 90.0, 10, 4, nodes=300)
    used = fine != 0
    assert np.abs(default[used] / fine[used] - 1).max() < 1e-6


@pytest.mark.parametrize(
    "wavelength, m, films, substrate", [(400.0, 0.05 + 2.1j, (), 1.5), (650.0, 3.85 + 0.02j, ((1.46, 300.0),), 3.8)]
)
def test_chosen_order_changes_by_a_thousandth_when_doubled(wavelength, m, films, substrate):
    radius = 90.0
    below = surface(wavelength, substrate, films)
    order = choose_order(below, radius, lambda lmax: t_matrix(lmax, below.wavenumber * radius, m))
    own = np.radians(np.arange(5.0, 90.0, 12.0)), np.radians([0.0, 30.0, 60.0, 80.0]), 9, ORDER_BAR
    # other directions than those that chose: a little room
    other = np.linspace(0.1, 1.5, 9), np.array([0.0, 0.5, 1.1]), 7, 1.3 * ORDER_BAR
    for leaving, arriving, azimuths, bar in (own, other):
        patterns = []
        for lmax in (order, 2 * order):
            ours = sphere(wavelength, radius, m, substrate, films, lmax=lmax)
            out, incident = ours.directions(np.cos(leaving)), ours.directions(np.cos(arriving))
            patterns.append(np.abs(amplitude(ours.harmonics(out, incident), np.linspace(0, np.pi, azimuths))) ** 2)
        change = np.sqrt(((patterns[0] - patterns[1]) ** 2).sum((0, 1, 4)) / (patterns[1] ** 2).sum((0, 1, 4)))
        assert change.max() <= bar


def test_metal_touching_silicon_is_refused():
    below = surface(450.0, 4.68 + 0.15j)
    with pytest.raises(MultipoleConvergenceError, match="does not converge"):
        choose_order(below, 90.0, lambda lmax: t_matrix(lmax, below.wavenumber * 90.0, 0.04 + 2.66j))
    assert choose_order(below, 92.0, lambda lmax: t_matrix(lmax, below.wavenumber * 90.0, 0.04 + 2.66j)) <= 40


@pytest.mark.parametrize("radius", [20.0, 70.0])
def test_small_particles_do_not_overflow_on_the_way_to_high_orders(radius):
    below = surface(800.0, 3.7 + 0.005j)
    order = choose_order(below, radius, lambda lmax: t_matrix(lmax, below.wavenumber * radius, 3.5 + 0.01j))
    assert 4 <= order <= 40
