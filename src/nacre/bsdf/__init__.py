"""The BSDF: a lobe sum, independent of the material family."""

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobe import Lobe, SpecularResponse
from nacre.bsdf.registry import LobeEntry, lobe_class
from nacre.bsdf.texture import ParameterAxis

__all__ = ["Bsdf", "Lobe", "LobeEntry", "ParameterAxis", "SpecularResponse", "lobe_class"]
