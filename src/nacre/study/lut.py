"""A material as tables of colour for engines: what is baked, what is refused, and how far it is from nacre."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from nacre._version import __version__
from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.directions import direction
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.bsdf.lobes.specular import Specular
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import ParameterAxis, refuse_place
from nacre.errors import UnsupportedError
from nacre.exchange.lobes import is_isotropic
from nacre.exchange.lut.table import (
    Closure,
    Facets,
    LightTable,
    Parameter,
    Picture,
    angle_coordinate,
    column_angles,
    lobe_value,
)  # fmt: skip
from nacre.exchange.lut.write import as_png
from nacre.light import delta_e_2000, spectrum_to_rgb_matrix, srgb_linear_to_xyz, xyz_to_lab
from nacre.light.tables import Illuminant, illuminant
from nacre.light.tristimulus import weighted_sum
from nacre.materials.material import Material
from nacre.measure.colour_wavelengths import colour_bsdf
from nacre.measure.evaluate import evaluate_with_error, hemispherical
from nacre.study.lut_facets import (
    COLUMNS,
    ClosureLoss,
    at_node,
    azimuths,
    closure_distribution,
    coloured,
    facet_bands,
    inner_index,
    over_azimuth,
    rough_view,
    sides,
    smooth_view,
)  # fmt: skip
from nacre.study.lut_scatter import PATHS, Scatter, lobe_pairs, make_scatter

MAP_SIZE = 512  # pixels a side of a formula's map
LARGEST_MAP = 4096
CHECKED = 64  # places at which a table is compared
CHECKED_PAIRS, CHECKED_WALKS = 64, 16384
STEEPEST_CHECKED_DEG = 80.0
CHECKED_DEG = np.array([2.5, 17.5, 32.5, 47.5, 62.0, 73.5])
NOTHING = 1e-6  # reflectance below which there is no part
Progress = Callable[[str], None]


def make_table(material: Material, lamp: str = "D65", progress: Progress = lambda what: None) -> LightTable:
    """Bake a material.

    Args:
        lamp: name of the illuminant.
        progress: told what is computed.

    Raises:
        UnsupportedError: a table cannot hold the material; says why.
    """
    source = material.context.source
    refuse_place(material.model, f"{source}: export")
    light = illuminant(lamp)
    progress("solving the material")
    bsdf = colour_bsdf(material, light.name)
    try:
        return _baked(material, bsdf, light, progress)
    except UnsupportedError as error:
        text = str(error)
        raise UnsupportedError(text if text.startswith(str(source)) else f"{source}: {text}") from None


def _baked(material: Material, bsdf: Bsdf, light: Illuminant, progress: Progress) -> LightTable:
    matrix = np.asarray(spectrum_to_rgb_matrix(bsdf.wavelengths_nm, light))

    def to_rgb(values: Array) -> Array:
        return np.asarray(weighted_sum(values, matrix))

    _refuse(bsdf)
    pictures: dict[str, Picture] = {}
    closures: list[Closure] = []
    errors: dict[str, dict[str, float]] = {}
    lost: list[str] = []
    facets, parameter = None, None
    interfaces = [lobe for lobe in bsdf.lobes if isinstance(lobe, Specular | Microfacet)]
    mirror = _walk_mirror(bsdf) if not interfaces else None
    axes = {axis.name: axis for lobe in interfaces for axis in lobe.parameters}
    if axes:
        (axis,) = axes.values()
        parameter = Parameter(axis.name, float(axis.values[0]), float(axis.values[-1]))
        pictures["map"] = Picture(_map(axis), f"{axis.name} over uv, from 0 to 1", is_data=True)
    if interfaces or mirror is not None:
        progress("the film's interface")
        facets = _bake_interface(interfaces, mirror, to_rgb, pictures, closures, errors)
    scattering = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    if scattering:
        alone = Bsdf(scattering, bsdf.provenance)
        scatter = make_scatter(material, alone, to_rgb, progress)
        _add_scatter(scatter, pictures, closures)
        progress("comparing with nacre")
        errors |= _scatter_errors(alone, scatter, to_rgb)
        lost += scatter.lost
    provenance = {"nacre": __version__, "recipe": material.text, "illuminant": light.name, "observer": "2deg"}
    return LightTable(
        material.name, light.name, pictures, tuple(closures), facets, parameter, errors, tuple(lost), provenance
    )


def _refuse(bsdf: Bsdf) -> None:
    """Refuse what no picture of this kind holds.

    Raises:
        UnsupportedError: with the reason.
    """
    facets = [lobe for lobe in bsdf.lobes if isinstance(lobe, Microfacet)]
    scattering = [lobe for lobe in bsdf.lobes if not isinstance(lobe, Microfacet | Specular)]
    names = dict.fromkeys(name for lobe in bsdf.lobes for name in lobe.varying)
    if any(isinstance(lobe, MaskedLobe) for lobe in bsdf.lobes):
        raise UnsupportedError(f"{', '.join(names)} blends whole materials over the surface; export each by itself")
    if len(names) > 1:
        raise UnsupportedError(f"{', '.join(names)} vary over the surface, and a table holds one; --set the others")
    if names and scattering:
        raise UnsupportedError(f"{', '.join(names)} varies and light is scattered below; a table holds one of both")
    if len(facets) > 1:
        raise UnsupportedError("has several rough interfaces, and a table holds one")
    for lobe in facets:
        if lobe.alpha_texture is not None or lobe.rotation is not None:
            what = "roughness" if lobe.alpha_texture is not None else "rotation"
            raise UnsupportedError(f"surface.{what} varies over the surface, which a table does not hold; --set it")
    steady = tuple(lobe for lobe in scattering if not lobe.is_stochastic and not lobe.is_delta)
    if steady and not is_isotropic(Bsdf(steady)):
        raise UnsupportedError(
            "scatters light by the direction about the normal, as grooves and reliefs do; a table of half and "
            "difference angle cannot hold that (--to rgl or exr can)"
        )


def _walk_mirror(bsdf: Bsdf) -> Array | None:
    """Return what a walk or a table sends into the mirror direction, `[column, wavelength]`; None: nothing."""
    found = bsdf.specular(np.minimum(column_angles(COLUMNS), np.radians(89.99)))
    return found.reflectance if found.reflectance.max() > NOTHING else None


def _map(axis: ParameterAxis) -> Array:
    """Return a number's map over uv, `[1, row, column, 3]`, the first row at v = 0."""
    image = axis.texture.image
    rows, columns = (MAP_SIZE, MAP_SIZE) if image is None else np.minimum(image.shape, LARGEST_MAP)
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    unit = axis.coordinate(axis.texture(np.stack([u, v], axis=-1))) / max(len(axis.values) - 1, 1)
    return np.repeat(unit[None, ..., None], 3, axis=-1)


def _bake_interface(
    lobes: list[Specular | Microfacet], mirror: Array | None, to_rgb: Callable[[Array], Array],
    pictures: dict[str, Picture], closures: list[Closure], errors: dict[str, dict[str, float]],
) -> Facets:  # fmt: skip
    """Add the pictures and closures of what is mirror-like."""
    if mirror is not None:
        values = to_rgb(mirror)[None]
        pictures["facet"] = Picture(values[None], "reflectance over the angle of incidence")
        pictures["mirror"] = Picture(values[None], "colour of the mirror over the angle of view")
        closures.append(Closure("glossy", "mirror"))
        return Facets("ggx", (0.0, 0.0), 1.0, False, False, False)
    rough = next((lobe for lobe in lobes if isinstance(lobe, Microfacet)), None)
    lobe = rough or lobes[0]
    response = _joined([coloured(each.response, to_rgb) for each in lobes])
    alpha = (rough.alpha_x, rough.alpha_y) if rough else (0.0, 0.0)
    distribution = rough.distribution if rough else "ggx"
    bends = rough is not None and rough.transmits
    facets = Facets(distribution, alpha, response.eta, response.flipped, response.transmits, not bends)
    pictures["facet"] = Picture(facet_bands(response), "what a facet reflects and passes, over the angle to the light")
    if rough is not None:
        exchange = None if rough.exchange is None else to_rgb(rough.exchange)
        rough = dataclasses.replace(rough, response=coloured(rough.response, to_rgb), exchange=exchange)
        _add_loss(rough, pictures)
    names: dict[str, list[str | None]] = {"mirror": [], "through": []}
    for is_behind in (False, True) if response.transmits else (False,):
        views = rough_view(rough, is_behind) if rough else smooth_view(response, is_behind)
        passed = views.passed if bends or rough is None else smooth_view(response, is_behind).passed
        for name, values, what in (("mirror", views.reflected, "reflects"), ("through", passed, "passes")):
            title = name + ("-behind" if is_behind else "")
            if values.max() <= NOTHING:
                names[name].append(None)
                continue
            side = ", seen from behind" if is_behind else ""
            about = f"colour of the closure that {what}, over the angle of view{side}"
            rows = "parameter" if response.parameters else "azimuth" if len(values) > 1 else ""
            pictures[title] = Picture(values[None], about, rows=rows)
            names[name].append(title)
    own = closure_distribution(distribution)
    closures.append(Closure("glossy", *_pair(names["mirror"]), distribution=own, alpha=alpha))
    if names["through"] and any(names["through"]):
        ior = 1.0 / response.eta if response.flipped else response.eta
        kind = "straight" if response.eta == 1.0 else "refract"
        closures.append(Closure(kind, *_pair(names["through"]), distribution=own, alpha=alpha, ior=ior))
    errors |= _interface_errors(lobe, rough, response, pictures)
    return facets


def _pair(names: list[str | None]) -> tuple[str | None, str | None]:
    return names[0], names[1] if len(names) > 1 else None


def _joined(responses: list[InterfaceResponse]) -> InterfaceResponse:
    """Return one interface from those of a rough free film: its facets reflect, and light passes straight through.

    Raises:
        UnsupportedError: they do not belong together.
    """
    first, *others = responses
    for other in others:
        if other.reflectance.shape != first.reflectance.shape or (other.eta, first.eta) != (1.0, 1.0):
            raise UnsupportedError("has several interfaces of its own, and a table holds one")
        first = dataclasses.replace(
            first, transmittance=first.transmittance + other.transmittance, reflectance=first.reflectance
            + other.reflectance, reflectance_inside=first.reflectance_inside + other.reflectance_inside,
            transmits=first.transmits or other.transmits,
        )  # fmt: skip
    return first


def _add_loss(lobe: Microfacet, pictures: dict[str, Picture]) -> None:
    """Add what makes up for light lost between facets, for shaders that know the light."""
    if lobe.loss is None or lobe.exchange is None:
        return
    count = lobe.loss.shape[0]
    loss = np.swapaxes(lobe.loss[..., :1], 1, 2)  # rows over t, columns over s
    pictures["loss"] = Picture(np.repeat(loss, 3, axis=-1), "light lost between facets along a direction", is_data=True)
    exchange = lobe.exchange.reshape(-1, count * count, 3)
    bands = np.moveaxis(exchange, 1, 0)[:, :, None, :]
    pictures["exchange"] = Picture(bands, "colour of the light between facets, 1/sr")


def _interface_errors(
    lobe: Specular | Microfacet, rough: Microfacet | None, response: InterfaceResponse, pictures: dict[str, Picture]
) -> dict[str, dict[str, float]]:
    """Compare the pictures between their nodes: a facet's colour, and the colour under even light by angle of view."""
    generator = np.random.default_rng(0)
    theta = np.radians(generator.uniform(0.0, STEEPEST_CHECKED_DEG, CHECKED))
    rows = generator.integers(0, max(pictures["facet"].values.shape[1], 1), CHECKED)
    last = max(pictures["facet"].values.shape[1] - 1, 1)
    found = {}
    reflected, _ = sides(response, np.cos(theta), response.flipped)
    wanted = reflected[rows, np.arange(CHECKED)]
    at = (angle_coordinate(np.cos(theta)), rows / last)
    found["reflectance of a facet"] = compared(pictures["facet"], lambda p: p.at(*at), wanted)
    if rough is None:
        return found
    alpha = (rough.alpha_x, rough.alpha_y)
    closure = ClosureLoss(closure_distribution(rough.distribution), alpha, inner_index(response, False))
    turns = generator.uniform(0.0, np.pi / 2, CHECKED)
    sent, kept = np.zeros((CHECKED, 3)), np.zeros(CHECKED)
    for i, (t, turn) in enumerate(zip(theta, turns, strict=True)):
        w = direction(t, turn if len(azimuths(alpha)) > 1 else 0.0)
        sent[i] = _node(rough, int(rows[i])).hemispherical(w)[0]
        kept[i] = closure.kept(w)[0]
    height = np.cos(turns) ** 2 if over_azimuth(rough) else at[1]
    found["under even light, by angle of view"] = compared(
        pictures["mirror"], lambda p: p.at(at[0], height) * kept[:, None], sent
    )
    return found


def _node(lobe: Microfacet, row: int) -> Microfacet:
    """Return a film that varies as it is at one node of the number."""
    if not lobe.parameters:
        return lobe
    exchange = None if lobe.exchange is None else lobe.exchange[row]
    return dataclasses.replace(lobe, response=at_node(lobe.response, (row,)), exchange=exchange)


def _add_scatter(scatter: Scatter, pictures: dict[str, Picture], closures: list[Closure]) -> None:
    """Add the pictures and closures of scattered light."""
    views = "colour over the angle of view of "
    behind = (None, None) if scatter.behind is None else ("spread-behind", "translucent-behind")
    if scatter.gloss is not None:
        pictures["gloss"] = view_picture(scatter.gloss, views + "the lobe about the mirror direction")
        closures.append(Closure("glossy", "gloss", alpha=(scatter.gloss_alpha, scatter.gloss_alpha)))
    pictures["spread"] = view_picture(scatter.spread, views + "light that leaves on all sides")
    closures.append(Closure("diffuse", "spread", behind[0]))
    if scatter.through is not None and scatter.behind is not None:
        pictures["translucent"] = view_picture(scatter.through, views + "light scattered through")
        pictures["spread-behind"] = view_picture(scatter.behind[0], views + "light that leaves below, from below")
        pictures["translucent-behind"] = view_picture(scatter.behind[1], views + "light through, from below")
        closures.append(Closure("translucent", "translucent", behind[1]))
    if scatter.lobe is not None:
        pictures["lobe"] = scatter.lobe


def view_picture(values: Array, about: str = "") -> Picture:
    """Return the picture of colours over the angle of view alone, `[column, 3]`."""
    return Picture(values[None, None], about)


def _scatter_errors(bsdf: Bsdf, scatter: Scatter, to_rgb: Callable[[Array], Array]) -> dict[str, dict[str, float]]:
    """Compare scattered light with nacre: under one lamp, at pairs of directions."""
    theta = np.radians(CHECKED_DEG)
    back = [sum(hemispherical(lobe, w, nodes=PATHS, seed=1)[0] for lobe in bsdf.lobes) for w in direction(theta, 0.0)]
    alpha = max(scatter.gloss_alpha, 1e-3)
    kept = np.array([ClosureLoss("ggx", (alpha, alpha)).kept(w)[0] for w in direction(theta, 0.0)])
    x = angle_coordinate(np.cos(theta))

    def even(held: Picture) -> Array:
        glossy = 0.0 if scatter.gloss is None else view_picture(scatter.gloss).at(x, 0.0 * x) * kept[:, None]
        return held.at(x, 0.0 * x) + glossy

    told = "scattered light under even light, by angle of view"
    found = {told: compared(view_picture(scatter.spread), even, to_rgb(np.array(back)))}
    if scatter.lobe is not None:
        lowest = float(np.cos(np.radians(STEEPEST_CHECKED_DEG)))
        wi, wo = lobe_pairs(CHECKED_PAIRS, 1, lowest)
        values, _ = evaluate_with_error(bsdf, wi, wo, samples=CHECKED_WALKS, seed=1)
        wanted = np.pi * wi[:, 2:] * to_rgb(np.nan_to_num(values))
        found["scattered light, lit from one direction"] = compared(
            scatter.lobe, lambda p: np.pi * wi[:, 2:] * lobe_value(p, wi, wo), wanted
        )
    return found


def compared(picture: Picture, look_up: Callable[[Picture], Array], wanted: Array) -> dict[str, float]:
    """Return mean and largest dE00 of a picture's colours to the right ones, of the EXR and of the PNG."""
    lab = _lab(wanted)
    told: dict[str, float] = {}
    for ending, held in (("", picture), ("_png", as_png(picture))):
        difference = np.asarray(delta_e_2000(_lab(look_up(held)), lab))
        told |= {f"mean{ending}": float(difference.mean()), f"max{ending}": float(difference.max())}
    return told


def _lab(rgb: Array) -> Array:
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(rgb)))
