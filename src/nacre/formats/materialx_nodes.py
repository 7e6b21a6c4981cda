"""Values of connected inputs in MaterialX documents: constants, and linear functions of one image.

Followed are node graphs, interface inputs, and the nodes constant, dot, convert, image, tiledimage, add, subtract,
multiply, divide, invert, mix, range and remap of floats. Files before version 1.38, whose materials refer to shaders by
`shaderref` and `bindinput`, are read as well.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import plain

DEEPEST = 32  # connections in a row
MAX_PIXELS = 1 << 26
IMAGES = ("image", "tiledimage")
SAME = ("dot", "convert")
ONES = ("1, 1", "1,1", "1.0, 1.0", "1.0,1.0")


@dataclass(frozen=True)
class Number:
    """`constant + slope * image`; the image `[row, column]`, from 0 to 1, has its first row at the top."""

    constant: float
    slope: float = 0.0
    image: Array | None = None

    def scaled(self, factor: float, offset: float = 0.0) -> Number:
        """Return `factor * self + offset`."""
        return replace(self, constant=factor * self.constant + offset, slope=factor * self.slope)

    @property
    def ends(self) -> tuple[float, float]:
        """The numbers where the image is 0 and 1."""
        return self.constant, self.constant + self.slope

    @property
    def mean(self) -> float:
        """The mean over the image."""
        return self.constant + (self.slope * float(self.image.mean()) if self.image is not None else 0.0)


def surfaces(root: ET.Element, kinds: tuple[str, ...]) -> Iterator[ET.Element]:
    """Yield the surface shaders of a document, those of old files as today's nodes."""
    for node in root.iter():
        if node.tag in kinds:
            yield node
        elif node.tag == "shaderref" and node.get("node") in kinds:
            made = ET.Element(str(node.get("node")), name=node.get("name", ""))
            for bound in node.findall("bindinput"):
                more = {"nodegraph": bound.get("opgraph", "")} if bound.get("opgraph") else {}
                ET.SubElement(made, "input", bound.attrib | more)
            yield made


class Document:
    """A document whose connections are followed; images lie in its folder."""

    def __init__(self, root: ET.Element, path: Path) -> None:
        self.root, self.folder = root, path.parent
        self.prefix = root.get("fileprefix", "")
        self.graphs = {graph.get("name", ""): graph for graph in root.iter("nodegraph")}

    def number(self, entry: ET.Element, scope: ET.Element | None = None, depth: int = 0) -> Number | None:
        """Return the number of a float input, or None if its nodes are not supported.

        Args:
            scope: the input's graph; None: the document.
        """
        found = self._follow(entry, scope, depth)
        if found is None:
            return None
        node, scope, depth = found
        if isinstance(node, str):
            return Number(float(node))
        if depth > DEEPEST:
            return None
        if node.tag in IMAGES:
            return self._image(node, scope, depth)
        inputs = {str(i.get("name")): i for i in node.findall("input")}

        def of(name: str, default: float | None = None) -> Number | None:
            if name in inputs:
                return self.number(inputs[name], scope, depth + 1)
            return None if default is None else Number(default)

        if node.tag == "constant":
            return of("value", 0.0)
        if node.tag in SAME:
            return of("in")
        return _computed(str(node.tag), of)

    def text(self, entry: ET.Element, scope: ET.Element | None = None) -> str | None:
        """Return the text of an input that a constant gives, of any type, or None."""
        found = self._follow(entry, scope, 0)
        if found is None:
            return None
        constant, inside, _ = found
        if isinstance(constant, str):
            return constant
        value = next((i for i in constant.findall("input") if i.get("name") == "value"), None)
        return self.text(value, inside) if constant.tag == "constant" and value is not None else None

    def _follow(
        self, entry: ET.Element, scope: ET.Element | None, depth: int
    ) -> tuple[ET.Element | str, ET.Element | None, int] | None:
        """Return the text or the node that an input is connected to, with its graph."""
        while depth <= DEEPEST:
            depth += 1
            inside = self.root if scope is None else scope
            if entry.get("interfacename"):
                named = [i for i in inside.findall("input") if i.get("name") == entry.get("interfacename")]
                if not named:
                    return None
                entry, scope = named[0], None
            elif entry.get("nodegraph"):
                graph = self.graphs.get(str(entry.get("nodegraph")))
                outputs = [] if graph is None else graph.findall("output")
                wanted = [o for o in outputs if o.get("name") == entry.get("output")] or outputs
                if not wanted:
                    return None
                entry, scope = wanted[0], graph
            elif entry.get("nodename"):
                nodes = [n for n in inside if n.get("name") == entry.get("nodename") and n.tag != "output"]
                return (nodes[0], scope, depth) if nodes else None
            elif entry.get("value") is not None:
                return str(entry.get("value")), scope, depth
            else:
                return None
        return None

    def _image(self, node: ET.Element, scope: ET.Element | None, depth: int) -> Number | None:
        inputs = {str(i.get("name")): i for i in node.findall("input")}
        if "file" not in inputs or node.get("type") != "float":
            return None
        if "texcoord" in inputs:
            at = self._follow(inputs["texcoord"], scope, depth)
            if at is None or isinstance(at[0], str) or at[0].tag != "texcoord":
                return None
        tiling, file = inputs.get("uvtiling"), self.text(inputs["file"], scope)
        if file is None or (tiling is not None and self.text(tiling, scope) not in ONES):
            return None
        image = read_red(self.folder, inputs["file"].get("fileprefix", self.prefix) + file)
        return None if image is None else Number(0.0, 1.0, image)


def _computed(kind: str, of: Callable[..., Number | None]) -> Number | None:
    """Return the result of an arithmetic node, linear in at most one image."""
    first, second = of("in1", 0.0), of("in2", 1.0 if kind in ("multiply", "divide") else 0.0)
    if kind in ("add", "subtract") and first is not None and second is not None:
        return _sum(first, second.scaled(-1.0 if kind == "subtract" else 1.0))
    if kind == "multiply" and first is not None and second is not None:
        return _product(first, second)
    if kind == "divide" and first is not None and second is not None:
        return first.scaled(1.0 / second.constant) if second.image is None and second.constant else None
    if kind == "invert":
        amount, value = of("amount", 1.0), of("in", 0.0)
        return None if amount is None or value is None else _sum(amount, value.scaled(-1.0))
    if kind == "mix":
        front, back, share = of("fg", 0.0), of("bg", 0.0), of("mix", 0.0)
        if front is None or back is None or share is None:
            return None
        change = _product(_sum(front, back.scaled(-1.0)), share)
        return None if change is None else _sum(back, change)
    if kind in ("range", "remap"):
        value = of("in", 0.0)
        limits = [
            of(name, default) for name, default in (("inlow", 0.0), ("inhigh", 1.0), ("outlow", 0.0), ("outhigh", 1.0))
        ]
        if value is None or any(limit is None or limit.image is not None for limit in limits):
            return None
        a, b, c, d = (limit.constant for limit in limits if limit is not None)
        factor = (d - c) / (b - a) if b != a else 0.0
        return value.scaled(factor, c - factor * a)
    return None


def _sum(first: Number | None, second: Number | None) -> Number | None:
    if first is None or second is None or (first.image is not None and second.image is not None):
        return None
    constant = first.constant + second.constant
    held = first if first.image is not None else second
    return Number(constant, held.slope, held.image)


def _product(first: Number | None, second: Number | None) -> Number | None:
    if first is None or second is None:
        return None
    if second.image is None:
        return first.scaled(second.constant)
    return second.scaled(first.constant) if first.image is None else None


def read_red(folder: Path, name: str) -> Array | None:
    """Return the first channel of an image in a folder, from 0 to 1; None if it cannot be read."""
    from PIL import Image

    place = Path(name)
    if place.is_absolute() or ".." in place.parts:
        return None
    try:
        with Image.open(plain(folder / place)) as opened:
            if opened.width * opened.height > MAX_PIXELS:
                return None
            values = np.asarray(opened, dtype=float) / (65535.0 if opened.mode.startswith("I") else 255.0)
            return values if values.ndim == 2 else values[..., 0]
    except (OSError, ValueError, Image.DecompressionBombError):
        return None
