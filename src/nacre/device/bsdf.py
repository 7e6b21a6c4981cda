"""From a Bsdf to a `mi.BSDF` of the current variant, and the registry of Mitsuba plugins.

A new lobe needs one line here and one in `nacre.bsdf.registry`; a lobe of another package names its plugin in
its entry point. Plugins do not import this file: those that contain other lobes receive `make_plugin`.
For the RGB variants of Mitsuba, lobes are projected to linear sRGB.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
from typing import Any

import mitsuba as mi
import numpy as np

from nacre.bsdf.bsdf import Bsdf, is_isotropic
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import AlignedMicrofacet, AlignedSpecular
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.table import TableLobe, directions_of
from nacre.bsdf.registry import outside_lobe
from nacre.bsdf.texture import place_formula
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.device.lobe_sum import DevicePolarisation, bsdf_class, update_lobes
from nacre.device.plugin import LobePlugin, logger
from nacre.device.tables import ObjectFrame, ObjectSpace
from nacre.device.variant import RGB, VARIANTS
from nacre.light import spectrum_to_rgb_matrix

# The renderer samples wavelengths from 360 to 830 nm; nearly the whole luminance is in this range.
VISIBLE_NM = (400.0, 700.0)
SEEN_DEG = 1.0  # narrower errors of tables over angle are too small a part of a picture


def make_bsdf(
    bsdf: Bsdf,
    two_sided: bool = False,
    properties: Any = None,
    object_frame: ObjectFrame | None = None,
    v_up: bool = True,
) -> Any:
    """Convert a Bsdf to a `mi.BSDF` of the current variant.

    Args:
        bsdf: the material's lobes.
        two_sided: give an opaque material the same appearance from behind rather than black; a transmitting one always
            has its own back side.
        properties: Mitsuba's properties, from the scene loader.
        object_frame: the object's position, for formulas in x, y and z.
        v_up: whether v runs upward on the shapes with this BSDF (not on Mitsuba's sphere and in its OBJ reader).

    Raises:
        UnsupportedError: a lobe without plugin, a non-spectral variant, or a formula in x, y, z without
            `object_frame`.

    Example: `mi.load_dict({"type": "sphere", "bsdf": make_bsdf(nacre.load("soap").bsdf())})`.
    """
    if mi.variant() not in VARIANTS + RGB:
        raise UnsupportedError(f"Mitsuba variant {mi.variant()} cannot carry spectral materials; use {VARIANTS[0]}")
    grid = bsdf.wavelengths_nm
    if mi.is_rgb:
        _warn_of_rgb(mi.variant())
        bsdf = projected_to_rgb(bsdf)
    if grid[0] > VISIBLE_NM[0] or grid[-1] < VISIBLE_NM[1]:
        logger.warning(
            "the material is known only from %g to %g nm; its end values continue, so colours are inexact",
            grid[0],
            grid[-1],
        )
    if inexact := bsdf.error_ranges(least_deg=SEEN_DEG):
        logger.warning("%s", inexact)
    formula = place_formula(bsdf)
    if formula is not None and object_frame is None:
        raise UnsupportedError(
            f'formula "{formula[:80]}" uses x, y, z of the object, which are unknown in your own Mitsuba scene; '
            "use u and v, one of nacre's scenes with shape = your mesh, or make_bsdf(..., object_frame=...)"
        )
    frame = object_frame if formula is not None else None
    space = None if frame is None and v_up else ObjectSpace(frame, v_up)
    lobes, polarisation = bsdf.lobes, None
    if mi.is_polarized:
        tables = bsdf.polarisation() if bsdf.polarisation is not None else None
        if tables is None:
            _say_unpolarised(", ".join(dict.fromkeys(lobe.kind for lobe in lobes)))
        else:
            is_of_azimuth = any(isinstance(lobe, AlignedSpecular | AlignedMicrofacet) for lobe in lobes)
            polarisation = DevicePolarisation(tables, is_of_azimuth)
            lobes = tuple(tables.refined(lobe) for lobe in lobes)
    plugins = [make_plugin(lobe) for lobe in lobes]
    cls = bsdf_class(mi.variant())
    properties = mi.Properties() if properties is None else properties
    return cls(properties, plugins, two_sided and not bsdf.transmits, space, polarisation)


@functools.cache
def _say_unpolarised(kinds: str) -> None:
    """State once that a material has no Mueller matrices."""
    logger.warning("a material of %s reflects and transmits unpolarised light in polarised pictures", kinds)


@functools.cache
def _warn_of_rgb(variant: str) -> None:
    """Log once the limitations of an RGB variant."""
    logger.warning(
        "%s: materials are projected to linear sRGB under D65; other lamps, metamerism and saturated interreflections "
        "are lost",
        variant,
    )


def update_bsdf(target: Any, bsdf: Bsdf) -> None:
    """Replace a BSDF's data in a built scene by another Bsdf's with the same structure, without a new kernel.

    Raises:
        UnsupportedError: number, kinds or shapes of the lobes differ, formulas in x, y, z appeared or vanished, or
            there are Mueller matrices: build the scene again.
    """
    if mi.is_polarized and (target.sum.polarisation is not None or bsdf.polarisation is not None):
        raise UnsupportedError("the Mueller matrices may have changed; build the scene again")
    has_place = target.object_space is not None and target.object_space.has_place
    if (place_formula(bsdf) is not None) != has_place:
        raise UnsupportedError("formulas in x, y, z appeared or vanished; build the scene again")
    update_lobes(target, bsdf.lobes)


PLUGINS: dict[str, str] = {
    # lobe kind -> "module:class", imported on first use
    "specular": "nacre.device.lobes.interface:SpecularPlugin",
    "microfacet": "nacre.device.lobes.interface:MicrofacetPlugin",
    "aligned-microfacet": "nacre.device.lobes.interface:AlignedMicrofacetPlugin",
    "diffuse": "nacre.device.lobes.interface:DiffusePlugin",
    "ridge": "nacre.device.lobes.ridge:RidgePlugin",
    "ridge-table": "nacre.device.lobes.ridge:RidgeTablePlugin",
    "table": "nacre.device.lobes.table:TablePlugin",
    "harmonic": "nacre.device.lobes.monolayer:HarmonicPlugin",
    "aligned": "nacre.device.lobes.monolayer:AlignedPlugin",
    "aligned-specular": "nacre.device.lobes.interface:AlignedSpecularPlugin",
    "spectrum-map": "nacre.device.lobes.spectrum_map:SpectrumMapPlugin",
    "layered": "nacre.device.lobes.layered:LayeredPlugin",
    "platelet-layer": "nacre.device.lobes.platelet_layer:PlateletLayerPlugin",
    "orders": "nacre.device.lobes.orders:OrdersPlugin",
    "masked": "nacre.device.lobes.masked:MaskedPlugin",
}


def plugin_class(kind: str) -> type[LobePlugin[Any]]:
    """Return the plugin class for a lobe kind, importing its module.

    Raises:
        UnsupportedError: unknown kind.
        NacreError: another package registers this kind without a `LobePlugin`.
    """
    if kind in PLUGINS:
        module, name = PLUGINS[kind].split(":")
        cls: type[LobePlugin[Any]] = getattr(importlib.import_module(module), name)
        return cls
    try:
        outside = outside_lobe(kind).twin()
    except KeyError:
        known = ", ".join(PLUGINS)
        raise UnsupportedError(f'a lobe of kind "{kind}" has no Mitsuba plugin; known: {known}') from None
    if not (isinstance(outside, type) and issubclass(outside, LobePlugin)):
        raise NacreError(f'the Mitsuba plugin of the lobe "{kind}" is not a LobePlugin')
    return outside


def make_plugin(lobe: Lobe) -> LobePlugin[Any]:
    """Return one lobe's plugin for the current variant.

    Raises:
        UnsupportedError: a kind without plugin.
    """
    cls: Any = plugin_class(lobe.kind)
    plugin: LobePlugin[Any] = cls(lobe, make_plugin) if cls.holds_lobes else cls(lobe)
    return plugin


# linear in their spectral tables
LINEAR_KINDS = ("specular", "microfacet", "diffuse", "table", "aligned-specular", "aligned-microfacet")
CHANNELS = np.array([1.0, 2.0, 3.0])  # red, green and blue, used as wavelengths
NODES = (64, 46, 37)  # table nodes: root of the half angle, difference angle, its azimuth
HORIZON = 1e-3  # smallest cosine at a node


def projected_to_rgb(bsdf: Bsdf) -> Bsdf:
    """Return a Bsdf whose three "wavelengths" are linear red, green and blue under D65; values are clipped at 0.

    Products of spectra, such as those of two bounces, are then products of colours: saturated interreflections, lamps
    other than D65 and metamerism are lost. A lobe that is not linear in its spectra becomes a table over half and
    difference angles if it is isotropic and reflects only.

    Raises:
        UnsupportedError: a lobe allows neither, such as a random walk or the orders of a grating.
    """
    matrix = spectrum_to_rgb_matrix(bsdf.wavelengths_nm)
    return dataclasses.replace(
        bsdf, lobes=tuple(_projected_lobe(lobe, matrix) for lobe in bsdf.lobes), polarisation=None
    )


def _projected_lobe(lobe: Lobe, matrix: Array) -> Lobe:
    if isinstance(lobe, MaskedLobe):  # a share of a lobe is as linear as the lobe
        inner = _projected_lobe(lobe.inner, matrix)
        return dataclasses.replace(lobe, wavelengths_nm=CHANNELS, inner=inner)
    if lobe.kind not in LINEAR_KINDS:
        return _tabulated(lobe, matrix)
    projected: Lobe = _projected(lobe, matrix)
    return projected


def _tabulated(lobe: Lobe, matrix: Array) -> TableLobe:
    """Return the table of a lobe in three channels.

    Raises:
        UnsupportedError: it is random, transmits, reflects specularly, or depends on the azimuth.
    """
    mirror = lobe.specular(np.linspace(0.1, 1.0, 5)).reflectance
    reason = (
        'is a random walk (not with quality = "fast")' if lobe.is_stochastic
        else "transmits light" if lobe.transmits
        else "also reflects specularly" if mirror.max() > 0.0
        else "depends on the azimuth" if not is_isotropic(Bsdf((lobe,)))
        else ""
    )  # fmt: skip
    if reason:
        raise UnsupportedError(
            f'a lobe of kind "{lobe.kind}" cannot be projected to RGB: it {reason}; use a spectral variant of Mitsuba'
        )
    wi, wo = directions_of("half", NODES)
    is_up = np.minimum(wi[..., 2], wo[..., 2]) > HORIZON
    values = np.zeros((*NODES, 3))
    for row in range(NODES[0]):  # one at a time saves memory
        used = is_up[row]
        if not used.any():
            values[row] = values[row - 1]
            continue
        values[row][used] = np.maximum(np.nan_to_num(lobe.evaluate(wi[row][used], wo[row][used])) @ matrix, 0.0)
    for column in range(1, NODES[1]):  # below the horizon: the last node above it
        values[:, column] = np.where(is_up[:, column, :, None], values[:, column], values[:, column - 1])
    return TableLobe(CHANNELS, values, np.eye(3), "half")


def _projected(thing: Any, matrix: Array) -> Any:
    """Return a lobe or table with its spectral axes projected."""
    changes: dict[str, Any] = {}
    axes = getattr(thing, "AXES", {})
    for field in dataclasses.fields(thing):
        value = getattr(thing, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changes[field.name] = _projected(value, matrix)
        elif field.name == "wavelengths_nm":
            changes[field.name] = CHANNELS
        elif field.name == "relative_index":
            changes[field.name] = None
        elif isinstance(value, np.ndarray) and axes.get(field.name, "").endswith("wavelength"):
            is_spectral = value.shape[-1] == len(matrix)
            changes[field.name] = np.maximum(value @ matrix, 0.0) if is_spectral else value
    return dataclasses.replace(thing, **changes)
