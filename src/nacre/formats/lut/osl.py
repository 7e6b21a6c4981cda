"""The OSL shader of a table: colour over the angle of view on closures of the renderer's own."""

from __future__ import annotations

from nacre._version import __version__
from nacre.formats.lut.table import Closure, LightTable, Picture

HEAD = """// {name}: colours for {illuminant}, by nacre {version}. Linear sRGB, over the angle of view{rows}.
// Set `folder` to where the EXR pictures lie, ending in a slash.
#include "stdosl.h"

// A colour at x and p in [0, 1], both ends at the middles of texels; OSL counts rows from the top.
color nacre_look_up(string picture, float x, float p, float columns, float rows)
{{
    return (color) texture(picture, (x * (columns - 1) + 0.5) / columns, 1 - (p * (rows - 1) + 0.5) / rows,
                           "wrap", "clamp", "interp", "linear");
}}

shader {identifier}(
    string folder = "",
    point UV = point(u, v, 0),
    vector Tangent = dPdu,
    output closure color BSDF = 0)
{{
    float x = acos(clamp(fabs(dot(I, N)), 0, 1)) * M_2_PI;
    int behind = backfacing();
    float p = {parameter};
    float along = dot(I, normalize(Tangent)), across = dot(I, cross(N, normalize(Tangent)));
    float azimuth = along * along / max(along * along + across * across, 1e-12);
"""


def shader_text(table: LightTable, identifier: str) -> str:
    """Return the shader."""
    parameter, rows = "0", ""
    if table.parameter is not None:
        parameter = 'texture(concat(folder, "map.exr"), UV[0], 1 - UV[1], "wrap", "periodic")'
        rows = f" and over {' '.join(table.parameter.name.split())}"
    lines = [
        HEAD.format(
            name=" ".join(table.name.split()),
            illuminant=table.illuminant,
            version=__version__,
            rows=rows,
            identifier=identifier,
            parameter=parameter,
        )  # fmt: skip
    ]
    lines += [_part(table, closure) for closure in table.closures]
    return "".join(lines) + "}\n"


def _part(table: LightTable, closure: Closure) -> str:
    lines = ""
    for name, side in ((closure.front, "!behind"), (closure.behind, "behind")):
        if name is None:
            continue
        columns, rows = _size(table.pictures[name])
        row = "azimuth" if table.pictures[name].rows == "azimuth" else "p"
        found = f'nacre_look_up(concat(folder, "{name}.exr"), x, {row}, {columns}, {rows})'
        lines += f"    if ({side}) BSDF += {found} * {_closure(closure, side == 'behind')};\n"
    return lines


def _closure(closure: Closure, behind: bool) -> str:
    ior = 1.0 / closure.ior if behind else closure.ior
    x, y = closure.alpha
    if closure.kind == "diffuse":
        return "diffuse(N)"
    if closure.kind == "translucent":
        return "translucent(N)"
    if closure.kind == "straight":
        return "transparent()"
    if closure.kind == "refract":
        if x == 0.0:
            return f"refraction(N, {ior:.7g})"
        return f'microfacet("{closure.distribution}", N, Tangent, {x:.7g}, {y:.7g}, {ior:.7g}, 1)'
    if x == 0.0:
        return "reflection(N)"
    # Ashikhmin and Shirley's is Cycles' own word; another renderer has no such lobe
    distribution = closure.distribution.replace("-", "_")
    return f'microfacet("{distribution}", N, Tangent, {x:.7g}, {y:.7g}, 0, 0)'


def _size(picture: Picture) -> tuple[int, int]:
    bands, rows, columns = picture.values.shape[:3]
    return columns, bands * rows
