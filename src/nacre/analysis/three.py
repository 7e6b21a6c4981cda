"""A material as a package for three.js: its colour table, and colours under uniform light for light from all around."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nacre.analysis.lut import STEEPEST, ClosureLoss, azimuths, make_table, over_uv
from nacre.bsdf.texture import Texture
from nacre.core.arrays import Array, direction
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Masked
from nacre.formats.lut import Closure, LightTable, Picture, Share, ThreePart, check_folder, column_angles, write_three
from nacre.material.material import Material

COLUMNS = 64  # angles of view
REFLECTED, PASSED = ("glossy", "diffuse"), ("straight", "refract")


def export_three(material: Material, folder: Path, illuminant: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Write a package for three.js; return its facts.

    Raises:
        UnsupportedError: a table cannot represent the material, or its scattered light has no noise-free form.
        NacreError: the folder cannot be written.
    """
    check_folder(folder)
    if not isinstance(material.model, Masked):
        part, lost = _part(material, illuminant, progress)
        files = write_three(folder, material.name, [part], lost)
        return {"illuminant": part.table.illuminant, "lost": lost, "files": files, "errors_dE00": _errors(part)}
    parts: list[ThreePart] = []
    lost = []
    for name, one in (("first", material.model.first), ("second", material.model.second)):
        try:
            made, missing = _part(one, illuminant, _named(progress, name))
        except UnsupportedError as error:
            raise UnsupportedError(f"the part {name} of the blend: {error}; export the other part alone") from None
        parts.append(made)
        lost += [what for what in missing if what not in lost]
    share = _share(material.model.mask)
    files = write_three(folder, material.name, parts, lost, share)
    return {
        "illuminant": parts[0].table.illuminant, "lost": lost, "files": files, "mean_share": share.mean,
        "errors_dE00": {f"{name}: {what}": error for name, part in zip(("first", "second"), parts, strict=True)
                        for what, error in _errors(part).items()},
    }  # fmt: skip


def _named(progress: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda what: progress(f"{name}: {what}")


def _errors(part: ThreePart) -> dict[str, dict[str, float]]:
    return {what: dict(values) for what, values in part.table.errors.items()}


def _part(material: Material, illuminant: str, progress: Callable[[str], None]) -> tuple[ThreePart, list[str]]:
    """Return a material's table with its colours under uniform light, and the lost properties."""
    table = make_table(material, illuminant, progress)
    scatters = any(closure.kind == "diffuse" for closure in table.closures)
    if scatters and "lobe" not in table.pictures:
        raise UnsupportedError(
            f"{material.context.source}: scatters by a random walk without a noise-free form, which a "
            "shader needs; export a lut, whose colours over the angle of view three.js can use"
        )
    progress("colours under uniform light")
    even, alphas = even_pictures(table)
    lost = [part.replace("GLSL: ", "") for part in table.lost]
    if "through" in even:
        lost.append("the colour of the light that passes: what lies behind is seen through the mean of its channels")
    if table.facets is not None and table.facets.alpha[0] == 0:
        lost.append("highlights of point lights: a smooth surface reflects the light from all around only")
    return ThreePart(table, even, alphas), lost


def _share(mask: Texture) -> Share:
    """Return the share of a blend's first material."""
    if mask.low == mask.high:
        return Share(float(mask.low))
    values = over_uv(mask)
    return Share(float(np.mean(values)), values)


def even_pictures(table: LightTable) -> tuple[dict[str, Picture], tuple[float, ...]]:
    """Return colours under uniform light over the view angle, and the roughness of each "gloss" band.

    "albedo": all reflected light; "through": directly transmitted light; "spread": scattered light in all directions,
    each with a band for each side; "gloss": about the mirror direction, with a band for each width. A closure's colour
    times the energy of the white closure is what the material sends (`nacre.analysis.lut.rough_view`).
    """
    sums: dict[str, list[Array | None]] = {}
    rows_over = {picture.rows for picture in table.pictures.values() if picture.rows}
    rows = rows_over.pop() if rows_over else ""
    alphas: list[float] = []
    gloss: list[Array] = []
    for closure in table.closures:
        names = ["albedo"] if closure.kind in REFLECTED else ["through"] if closure.kind in PASSED else []
        if closure.front is not None and closure.front.startswith("gloss"):
            alphas.append(closure.alpha[0])
            gloss.append(np.asarray(_even(table, closure, closure.front, rows)))
        if closure.kind == "diffuse":
            names.append("spread")
        for name in names:
            sums[name] = [
                _added(old, _even(table, closure, side, rows))
                for old, side in zip(sums.get(name, [None, None]), (closure.front, closure.behind), strict=True)
            ]
    found = {"gloss": Picture(np.stack(gloss), "gloss under uniform light", rows=rows)} if gloss else {}
    for name, (front, behind) in sums.items():
        bands = [part for part in (front, behind) if part is not None]
        if not bands or max(float(band.max()) for band in bands) <= 0.0:
            continue
        if front is None:
            bands.insert(0, np.zeros_like(bands[0]))
        count = max(len(band) for band in bands)
        values = np.stack([np.broadcast_to(band, (count, *band.shape[1:])) for band in bands])
        found[name] = Picture(values, f"{name} under uniform light", rows=rows)
    return found, tuple(alphas)


def _added(old: Array | None, new: Array | None) -> Array | None:
    return new if old is None else old if new is None else old + new


def _even(table: LightTable, closure: Closure, name: str | None, rows_over: str) -> Array | None:
    """Return the colours `[row, column, 3]` that a closure sends under uniform light, on one side."""
    if name is None:
        return None
    picture, angles = table.pictures[name], np.minimum(column_angles(COLUMNS), STEEPEST)
    count = picture.values.shape[1]
    x = column_angles(COLUMNS) / (np.pi / 2)
    unit = np.linspace(0.0, 1.0, count) if count > 1 else np.zeros(1)
    values = np.stack([picture.at(x, np.full(COLUMNS, row)) for row in unit])
    if closure.alpha[0] == 0.0 or closure.kind not in ("glossy", "refract"):
        return values
    eta = 1.0 / closure.ior if name.endswith("-behind") else closure.ior
    loss, side = ClosureLoss(closure.distribution, closure.alpha, eta), int(closure.kind == "refract")

    def kept(turns: Array) -> Array:
        return np.array([np.mean([loss.kept(direction(t, turn))[side] for turn in turns]) for t in angles])

    if picture.rows == "azimuth" and rows_over == "azimuth":
        return values * np.stack([kept(np.array([np.arccos(np.sqrt(row))])) for row in unit])[..., None]
    return values * kept(azimuths(closure.alpha))[:, None]
