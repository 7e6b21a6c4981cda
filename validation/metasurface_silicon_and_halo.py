"""Published statements on disordered metasurfaces (Vynck et al., Nature Materials 21, 1035, 2022) against nacre.

Silicon on glass: the resonance shifts about linearly with the radius, and the diffuse spectrum keeps its place over
angle. Silver on glass: correlated particles keep light from the specular direction and raise it in a ring.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.material.material import material
from validation._rows import finish, row


def silicon(radius_nm: float) -> Any:
    """The source's silicon spheres on glass at f = 0.1."""
    return material(
        {
            "family": "metasurface",
            "substrate": "glass",
            "particle": {"material": "Si", "radius_nm": radius_nm},
            "monolayer": {"coverage": 0.1},
            "model": {"correction": "qca-balanced"},
        }
    )


def silver(density_per_um2: float, packing: float) -> Any:
    """The source's silver spheres on glass."""
    return material(
        {
            "family": "metasurface",
            "substrate": "glass",
            "particle": {"material": "Ag", "radius_nm": 90},
            "monolayer": {"density_per_um2": density_per_um2, "packing": packing},
        }
    )


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2))
    wavelengths = np.arange(400.0, 801.0, 10.0)
    radii = np.array([60.0, 75.0, 95.0])
    peaks = []
    for radius in radii:
        found = silicon(radius).spectrum(np.radians([30.0]), wavelengths)
        assert found.diffuse_reflectance is not None
        spectrum = found.diffuse_reflectance[0]
        long = wavelengths > 4.6 * radius  # the magnetic dipole: the longest resonance, near n d
        peaks.append(float(wavelengths[long][np.argmax(spectrum[long])]))
        left.plot(wavelengths, spectrum, label=f"r = {radius:g} nm")
    slope, offset = np.polyfit(radii, peaks, 1)
    bend = float(np.abs(np.polyval([slope, offset], radii) - peaks).max())
    over_angle = silicon(75.0).spectrum(np.radians([0.0, 30.0, 60.0]), wavelengths)
    diffuse, specular = over_angle.diffuse_reflectance, over_angle.specular_reflectance
    assert diffuse is not None and specular is not None

    def change(s: np.ndarray) -> float:
        shape = s / s.sum(axis=1, keepdims=True)
        return float(0.5 * np.abs(shape - shape[1]).sum(axis=1).max())

    wi = np.array([np.sin(np.radians(30.0)), 0.0, np.cos(np.radians(30.0))])
    theta = np.radians(np.arange(-80.0, 81.0, 1.0))
    # negative angles lie on the light's own side
    wo = np.stack([-np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    depth, ring = {}, {}
    for density, packing in ((5.0, 0.1273), (5.0, 0.5), (2.5, 0.5)):
        f = silver(density, packing).bsdf(np.array([450.0])).evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 0]
        at_mirror = f[np.argmin(np.abs(theta - np.radians(30.0)))]
        depth[density, packing] = float(at_mirror / f.max())
        ring[density, packing] = float(np.degrees(abs(theta[np.argmax(f)] - np.radians(30.0))))
        right.plot(np.degrees(theta), f, label=f"{density:g} /um$^2$, p = {packing:.2g}")
    left.set(xlabel="wavelength / nm", ylabel="diffuse reflectance")
    right.set(xlabel="view / degrees", ylabel="BRDF / sr$^{-1}$")
    left.legend(), right.legend()
    figure.tight_layout()
    path = finish(figure, out_dir, "metasurface_silicon_and_halo.png", dpi=120)
    steps = np.diff(peaks)
    table = [
        ("Si resonance shifts about linearly with r", "linear", f"{peaks} nm, {bend:.0f} nm off a line",
         bool(np.all(steps > 0) and bend < 20)),
        ("Si diffuse spectrum changes less over angle than the specular one", "diffuse < specular",
         f"{change(diffuse):.3f} against {change(specular):.3f}", change(diffuse) < change(specular)),
        ("Ag p = 0.5: diffuse light suppressed at the specular direction", "suppressed",
         f"{depth[5.0, 0.5]:.2f} of its maximum, {depth[5.0, 0.1273]:.2f} at p = f", depth[5.0, 0.5] < 0.3),
        ("the ring shrinks as density falls", "smaller",
         f"{ring[2.5, 0.5]:.0f} against {ring[5.0, 0.5]:.0f} degrees", ring[2.5, 0.5] < ring[5.0, 0.5]),
    ]  # fmt: skip
    return [row(*line, path) for line in table]


if __name__ == "__main__":
    main()
