"""The command `ellipsometry`: Psi, Delta, N, C, S and Mueller matrices of a recipe."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from nacre.cli import common
from nacre.core.errors import NacreError

DEFAULT_ANGLES = "65,70,75"


@click.command()
@click.argument("recipe")
@click.option("--angles-deg", default=DEFAULT_ANGLES, show_default=True, help="Incidence, such as 65,70,75 or 50:80:5.")
@click.option("--wavelengths-nm", default=None, help="Such as 400:800:5; default: chosen by the material.")
@click.option("--azimuth-deg", type=float, default=None, help="Azimuth of the direction to the light, from u.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with the conventions.")
@click.option("-o", "output", metavar="FILE.csv", help="Write CSV (or JSON, by the suffix) to a file.")
@common.set_option
@common.jobs_option
def ellipsometry(
    recipe: str, angles_deg: str, wavelengths_nm: str | None, azimuth_deg: float | None, as_json: bool,
    output: str | None, changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Print what an ellipsometer measures of RECIPE: Psi, Delta, N C S, Mueller matrix, pseudo-dielectric function.

    Delta: r_p / r_s = tan(Psi) exp(i Delta) for fields exp(+i w t), r_p = -r_s at normal incidence, so that a bare
    metal or wafer has Delta between 0 and 180 degrees, as in the programs of Woollam, Sentech, Accurion, Film Sense and
    Horiba (Is = S, Ic = C). The recipe's [instrument] table averages over bandwidth, cone and thickness spread.
    """
    from nacre.analysis.ellipsometry import compute_ellipsometry, ellipsometry_document
    from nacre.core.files import check_writable, write_text
    from nacre.material.material import recipe_provenance

    if output:
        if Path(output).suffix not in (".csv", ".json"):
            raise NacreError(f"-o {output}: the suffix must be .csv or .json")
        check_writable(output)
    angles, grid = common.angles(angles_deg), common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    found = compute_ellipsometry(material, angles, grid, azimuth_deg)
    if output and output.endswith(".csv") or not output and not as_json:
        text = _csv(found.wavelengths_nm, found.angles_deg, found.columns())
    document = None
    if as_json or output and output.endswith(".json"):
        document = json.dumps({**ellipsometry_document(found), "provenance": recipe_provenance(material)})
    if output:
        write_text(output, text if output.endswith(".csv") else f"{document}\n")
        common.note(output)
    if as_json:
        click.echo(document)
    elif not output:
        click.echo(text, nl=False)


def _csv(wavelengths_nm: np.ndarray, angles_deg: np.ndarray, columns: dict[str, np.ndarray]) -> str:
    lines = ["wavelength_nm,angle_of_incidence_deg," + ",".join(columns)]
    for a, angle in enumerate(angles_deg):
        for w, wavelength in enumerate(wavelengths_nm):
            values = ",".join(f"{value[a, w]:.9g}" for value in columns.values())
            lines.append(f"{wavelength:.9g},{angle:.9g},{values}")
    return "\n".join(lines) + "\n"


commands = {"ellipsometry": ellipsometry}
