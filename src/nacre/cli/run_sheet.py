"""Command that writes the run sheet of a coating."""

from __future__ import annotations

import json
from pathlib import Path

import click

from nacre.cli import common
from nacre.core.errors import NacreError

SUFFIXES = (".txt", ".csv", ".json", ".png", ".pdf", ".svg")


@click.command()
@click.argument("recipe")
@click.option("--wavelength-nm", type=float, default=550.0, show_default=True, help="Wavelength of the monitor.")
@click.option("--angle-deg", type=float, default=0.0, show_default=True, help="Angle of incidence of its light.")
@click.option("--quantity", type=click.Choice(["reflectance", "transmittance"]), default="reflectance",
              show_default=True, help="Signal of the monitor.")  # fmt: skip
@click.option("--noise", type=float, default=0.001, show_default=True, help="Standard deviation of the signal.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-o", "outputs", multiple=True, metavar="FILE",
              help="Table (.txt), curves (.csv), both (.json), figure (.png, .pdf, .svg); several times.")  # fmt: skip
@common.set_option
def runsheet(
    recipe: str, wavelength_nm: float, angle_deg: float, quantity: str, noise: float, as_json: bool,
    outputs: tuple[str, ...], changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Print the optical monitor signal, turning points and stop criterion of each layer of RECIPE."""
    from nacre.analysis.run_sheet import make_run_sheet, run_sheet_csv, run_sheet_document, run_sheet_text
    from nacre.core.files import check_writable, write_text

    for output in outputs:
        if Path(output).suffix not in SUFFIXES:
            raise NacreError(f"-o {output}: the suffix must be one of {', '.join(SUFFIXES)}")
        check_writable(output)
    material = common.load_material(recipe, changes)
    sheet = make_run_sheet(material, wavelength_nm, angle_deg, quantity, noise)
    document = run_sheet_document(sheet)
    for output in outputs:
        texts = {".txt": run_sheet_text, ".csv": run_sheet_csv}
        suffix = Path(output).suffix
        if suffix == ".json":
            write_text(output, json.dumps(document, indent=1) + "\n")
        elif suffix in texts:
            write_text(output, texts[suffix](sheet))
        else:
            from nacre.plot import save_figure
            from nacre.plot.run_sheet import run_sheet_figure

            curves = [(each.material, each.grown_nm, each.signal, each.turning_nm, each.turning_signal)
                      for each in sheet.layers]  # fmt: skip
            label = f"{quantity.capitalize()} at {wavelength_nm:g} nm (%)"
            save_figure(run_sheet_figure(curves, label, material.name), output, {"recipe": material.text})
        common.note(output)
    if as_json:
        click.echo(json.dumps(document))
    elif not outputs:
        click.echo(run_sheet_text(sheet), nl=False)


commands: dict[str, click.Command] = {"runsheet": runsheet}
