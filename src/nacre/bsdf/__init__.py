"""The BSDF contract: a sum of lobes, evaluated, stored and loaded without knowing any material."""

from nacre.bsdf.contract import Bsdf, Lobe, ParameterAxis, SpecularResponse, lobe_class, register_lobe

__all__ = ["Bsdf", "Lobe", "ParameterAxis", "SpecularResponse", "lobe_class", "register_lobe"]
