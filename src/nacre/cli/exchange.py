"""Commands that exchange files with other programs: export and import."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from nacre.cli import common
from nacre.core.errors import NacreError
from nacre.formats.export_formats import EXPORTS, FOLDER, export_remarks


@click.command()
@click.argument("recipe")
@click.option("--to", "target", required=True, type=click.Choice(sorted(EXPORTS)))
@click.option(
    "-o", "output", default=None, metavar="FILE", help="Default: RECIPE with the format's suffix; lut: a folder."
)
@click.option("--angle-step-deg", type=click.FloatRange(0.5, 30), default=10.0, show_default=True, help="csv: grid.")
@click.option("--wavelength-nm", type=float, default=None, help="zemax: one wavelength instead of XYZ.")
@click.option("--illuminant", default=None, help="lut: the lamp that the colours are for.  [default: D65]")
@click.option("--json", "as_json", is_flag=True, help="Print what was written and what was lost, as JSON.")
@common.set_option
@common.cache_option
@common.jobs_option
def export(
    recipe: str, target: str, output: str | None, angle_step_deg: float, wavelength_nm: float | None,
    illuminant: str | None, as_json: bool, changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Write RECIPE in another program's format and say what the format cannot hold."""
    from nacre.analysis.import_export import export_material
    from nacre.core.files import check_writable, short_name
    from nacre.formats.lut.write import check_folder

    path = Path(output) if output else Path(f"{short_name(recipe)}{EXPORTS[target]}")
    options: dict[str, Any] = {"angle_step_deg": angle_step_deg, "wavelength_nm": wavelength_nm}
    if target == FOLDER:
        check_folder(path)
        options |= {"illuminant": illuminant or "D65", "progress": lambda what: common.note(f"{what} ...")}
    else:
        if illuminant is not None:
            raise NacreError(f"--illuminant {illuminant}: is for --to lut; {target} holds no colours of one lamp")
        check_writable(path)
    material = common.load_material(recipe, changes)
    facts = export_material(material, target, path, **options)
    if as_json:
        click.echo(json.dumps(facts))
        return
    common.note(str(path))
    for line in export_remarks(facts):
        common.note(line)


@click.command(name="import")
@click.argument("file", metavar="FILE")
@click.option("-o", "output", default=None, metavar="RECIPE.toml", help="Default: FILE with the suffix .toml.")
@common.cache_option
@common.jobs_option
def import_(file: str, output: str | None) -> None:
    """Read a measurement or another program's material and write a recipe for it."""
    from nacre.analysis.import_export import import_material
    from nacre.core.files import check_writable

    path = Path(output) if output else Path(f"{Path(file).stem}.toml")
    if path.suffix != ".toml":
        raise NacreError(f"-o {path}: the suffix must be .toml")
    check_writable(path)
    for line in import_material(Path(file), path):
        common.note(line)
    common.note(str(path))


commands = {"export": export, "import": import_}
