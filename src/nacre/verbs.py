"""The commands of the trade as functions: the same words and the same defaults as on the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from nacre.design.fabricate import fabricate
from nacre.files import check_writable
from nacre.recipe import Material, load
from nacre.study.fit import Fit
from nacre.study.report import Report
from nacre.study.tolerance import Tolerance

__all__ = ["export", "fabricate", "fit", "import_", "report", "sweep", "tolerance"]


def _material(thing: Material | str | Path) -> Material:
    return load(thing) if isinstance(thing, str | Path) else thing


def report(
    thing: Material | str | Path,
    *,
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    seed: int = 0,
) -> Report:
    """Measure a material in the trade's geometries: Lab at 15 to 110 degrees, flop, gloss, haze, totals.

    Args:
        thing: a material, or the path of a recipe, `.nacre` file or design folder.
        illuminant, observer: of the colours.
        samples, seed: of the walk, for families that are evaluated by one.

    Raises:
        NacreError: the material cannot be loaded or measured.

    Example: `nacre.report("soap.toml").flop_index`.
    """
    from nacre.study.report import make_report

    return make_report(_material(thing), illuminant, observer, samples, seed)


def tolerance(
    thing: Material | str | Path, spreads: Iterable[str] = (), *, draws: int = 500, limit: float = 1.0, **options: Any
) -> Tolerance:
    """Turn manufacturing spreads into the distribution of colour, yield and ranked sensitivities.

    Args:
        thing: a material or a path.
        spreads: such as "layers[0].thickness_nm=2%", beside those of the recipe's `[tolerance]`.
        draws: number of materials; limit: dE00 within which one is right.
        options: the others of `nacre.study.tolerance.run_tolerance`.

    Raises:
        NacreError: no spread, or one that names no number of the recipe.
    """
    from nacre.study.tolerance import read_spreads, run_tolerance

    material = _material(thing)
    return run_tolerance(material, read_spreads(material, tuple(spreads)), draws=draws, limit=limit, **options)


def fit(
    measurement: str | Path, thing: Material | str | Path, free: Iterable[str] = (), *, starts: int = 4, **options: Any
) -> Fit:
    """Fit the free numbers of a recipe to a measurement.

    Args:
        measurement: CSV of a spectrum or of goniometer values.
        thing: a material or a path.
        free: such as "layers[0].thickness_nm=50:400", beside those of the recipe's `[fit]`.
        starts: refined starts; options: the others of `nacre.study.fit.run_fit`.

    Raises:
        NacreError: the measurement cannot be read, or nothing is free.
    """
    from nacre.study.fit import read_free, read_measurement, run_fit

    material = _material(thing)
    return run_fit(material, read_measurement(measurement), read_free(material, tuple(free)), starts=starts, **options)


def sweep(
    path: str | Path,
    output: str | Path | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int, int], None] | None = None,
) -> Path:
    """Compute a sweep, or what is missing of it; return the Zarr folder, whose failed points carry their errors.

    Args:
        path: the sweep's TOML file.
        output: the Zarr folder; default: the file's name with .zarr, in the present folder.
        workers, scheduler, progress: as `nacre.study.sweep.run_sweep`.

    Raises:
        NacreError: the file is wrong, or the folder holds another sweep.
    """
    from nacre.study.sweep import load_sweep, run_sweep

    store = Path(output) if output is not None else Path(f"{Path(path).stem}.zarr")
    run_sweep(load_sweep(path), store, workers=workers, scheduler=scheduler, progress=progress)
    return store


def export(thing: Material | str | Path, to: str, output: str | Path, **options: Any) -> dict[str, Any]:
    """Write a material in a foreign format; `["lost"]` of the answer says in words what it cannot hold.

    Args:
        thing: a material or a path.
        to: "rgl", "merl", "csv", "zemax", "gltf", "materialx", "exr" or "nacre".
        output: the file.
        options: those of `nacre.study.trade.export_material`.

    Raises:
        UnsupportedError: the format can hold nothing of the material.
        NacreError: the file cannot be written.
    """
    from nacre.study.trade import export_material

    check_writable(output)
    return export_material(_material(thing), to, Path(output), **options)


def import_(source: str | Path, recipe: str | Path) -> Material:
    """Turn a foreign file (goniometer CSV, MERL, RGL, Zemax, glTF, MaterialX) into a recipe, and load it.

    Args:
        source: the foreign file.
        recipe: the TOML file to write; tables go into a `.nacre` file beside it.

    Raises:
        NacreError: the file is none of the known formats, or is damaged.
    """
    from nacre.study.trade import import_material

    check_writable(recipe)
    import_material(Path(source), Path(recipe))
    return load(recipe)
