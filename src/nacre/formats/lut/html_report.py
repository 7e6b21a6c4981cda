"""The page that lies in a folder of tables and says what each file is, and how far the tables are from nacre."""

from __future__ import annotations

from html import escape

from nacre._version import __version__
from nacre.formats.lut.table import Closure, LightTable

STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b1f24;"
    "background:#fff}table{border-collapse:collapse;margin:1rem 0}td,th{border:1px solid #c8ccd2;padding:.3rem .6rem;"
    "text-align:left;vertical-align:top}img{width:16rem;height:5rem;image-rendering:pixelated;border:1px solid #c8ccd2}"
    "code,pre{font-size:.9em}pre{background:#f3f4f6;padding:.8rem;overflow:auto}"
    "@media(prefers-color-scheme:dark){body{color:#e6e8eb;background:#16181c}pre{background:#22262c}}"
)
FILES = (
    (
        "shader.glsl",
        "GLSL ES 3.00: for engines that know where each light is (three.js, Unreal by hand, own renderers)",
    ),
    ("shader.osl", "OSL: colour over the angle of view on the renderer's own closures (Cycles, Arnold, RenderMan)"),
    ("blender.py", "a script that builds the same as Blender's own nodes, for Cycles on every device and EEVEE"),
    ("material.mtlx", "the same as a MaterialX graph"),
    ("table.json", "all of this page for programs: sizes, closures, errors, and the recipe"),
)
KINDS = {
    "glossy": "reflects", "diffuse": "scatters evenly", "translucent": "scatters through",
    "straight": "passes straight on", "refract": "refracts",
}  # fmt: skip


def page_text(table: LightTable) -> str:
    """Return the page as HTML; it asks for nothing beside the pictures in its folder."""
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(table.name)}</title>',
        f"<style>{STYLE}</style><h1>{escape(table.name)}</h1>",
        f"<p>Tables of colour by nacre {__version__}, for <b>{escape(table.illuminant)}</b>, CIE 1931 2° observer,",
        "in linear sRGB; white is (1, 1, 1). They are baked for that lamp: light the scene with white, and do not",
        "multiply the colours by another lamp's, which is wrong by 1 to 9 dE00; bake another table with",
        "<code>--illuminant</code>.",
        "</p><h2>How far from nacre</h2>",
        _errors(table),
        "<h2>Files</h2>",
        _table(("file", "what it is"), [(f"<code>{name}</code>", escape(about)) for name, about in FILES]),
        "<h2>Pictures</h2><p>Each as EXR (float, unclipped) and as PNG (16 bits, sRGB code values of colour / scale;",
        "colours out of gamut moved at their hue and lightness). Columns run over an angle from 0 to 90 degrees, the",
        "ends at the middles of the first and last texel; rows, from below, over what varies on the surface or,",
        "of brushed surfaces, over the squared cosine of the azimuth of view against u.</p>",
        _table(("picture", "holds", "size", "PNG scale"), [_picture(table, name) for name in table.pictures]),
        "<h2>Closures</h2><p>For OSL, Blender and MaterialX, which do not know the light: each closure's colour is",
        "averaged over its lobe so that under even light it gives back what the material does. MaterialX has GGX only,",
        "and its renderers make up for light lost between facets by themselves.</p>",
        _table(("closure", "colours", "facets"), [_closure(c) for c in table.closures]),
        _glsl(table),
    ]
    if table.parameter is not None:
        p = table.parameter
        parts.append(
            f"<p><code>{escape(p.name)}</code> varies from {p.low:g} to {p.high:g}; <code>map</code> gives it over uv "
            "as p from 0 to 1. Put a map of your own in its place.</p>"
        )
    if table.lost:
        parts.append("<h2>Not held</h2><ul>" + "".join(f"<li>{escape(what)}</li>" for what in table.lost) + "</ul>")
    parts.append(f"<h2>Recipe</h2><pre>{escape(str(table.provenance.get('recipe', '')))}</pre>")
    return "\n".join(parts) + "\n</html>\n"


def _errors(table: LightTable) -> str:
    rows = []
    for what, told in table.errors.items():
        cells = [f"{told[key]:.2f}" for key in ("mean", "max", "mean_png", "max_png")]
        rows.append((escape(what), *cells))
    heads = ("compared, up to 80 degrees", "mean dE00, EXR", "largest", "mean dE00, PNG", "largest")
    return _table(heads, rows)


def _picture(table: LightTable, name: str) -> tuple[str, ...]:
    picture = table.pictures[name]
    bands, rows, columns = picture.values.shape[:3]
    size = f"{columns} x {bands * rows}" + (f" ({bands} bands of {rows})" if bands > 1 else "")
    image = f'<img src="{name}.png" alt="{escape(picture.about)}">'
    return f"<code>{name}</code><br>{image}", escape(picture.about), size, f"{picture.png_scale:.6g}"


def _closure(closure: Closure) -> tuple[str, ...]:
    names = [closure.front or "none", *([f"{closure.behind} (from behind)"] if closure.behind else [])]
    facets = ""
    if closure.kind in ("glossy", "refract"):
        x, y = closure.alpha
        facets = "smooth" if x == 0 else f"{closure.distribution}, alpha {x:.4g} along u, {y:.4g} across"
    if closure.kind == "refract":
        facets += f", index {closure.ior:.4g}"
    return KINDS[closure.kind], escape(", ".join(names)), escape(facets)


def _glsl(table: LightTable) -> str:
    calls = []
    if "lobe" in table.pictures or (table.facets is not None and table.facets.alpha[0] > 0):
        calls.append("vec3 f = nacreBrdf(wi, wo, p);  // 1/sr, without the cosine: light * f * wi.z is what is seen")
    if table.facets is not None:
        calls.append(
            "vec3 reflected, passed;\nnacreMirror(wo, p, reflected, passed);  // of mirror directions, straight on"
        )
    calls.append("vec3 c = nacreColour(picture, cosine, p, 0.0, 1.0);  // any view picture, for blurred surroundings")
    bound = [f"nacre{name.capitalize()}" for name in ("facet", "loss", "exchange", "lobe") if name in table.pictures]
    return (
        "<h2>GLSL</h2><p>Bind the EXR pictures as half or full floats with linear filtering and clamped edges, the "
        f"first row at the bottom: {escape(', '.join(bound))}. With <code>#define NACRE_PNG</code> bind the PNG ones "
        "instead, undecoded (<code>loss</code> always as it is). Directions: z is the normal.</p>"
        f"<pre>{escape(chr(10).join(calls))}</pre>"
    )


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    head = "".join(f"<th>{head}</th>" for head in heads)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"
