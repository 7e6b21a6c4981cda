"""Free spheres live in `nacre.matter.mie`, since the dyes of a pearl need them too; this keeps their name here."""

from nacre.matter.mie import (
    MieEfficiencies,
    default_order,
    mie_amplitudes,
    mie_coefficients,
    mie_efficiencies,
)

__all__ = ["MieEfficiencies", "default_order", "mie_amplitudes", "mie_coefficients", "mie_efficiencies"]
