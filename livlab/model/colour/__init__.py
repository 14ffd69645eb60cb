"""From spectra to colour: three routes to linear sRGB, colour differences, and image files."""

from livlab.model.colour.difference import delta_e_2000
from livlab.model.colour.encoding import Gamut, decode_srgb, encode_srgb, in_gamut, out_of_gamut
from livlab.model.colour.files import write_exr, write_png
from livlab.model.colour.observers import (
    cie_rgb,
    cie_weights,
    colour_error,
    daylight_doubt,
    daylight_lab,
    sampling_error,
)
from livlab.model.colour.primaries import SRGB_TO_XYZ, lab
from livlab.model.colour.routes import (
    CHANNEL_CENTRES_NM,
    channel_wavelengths,
    stochastic_rgb,
    stochastic_weights,
    thesis_rgb,
    thesis_weights,
    to_rgb,
    to_rgb_error,
)
from livlab.model.colour.sight import ILLUMINANTS, OBSERVERS

__all__ = [
    "CHANNEL_CENTRES_NM",
    "ILLUMINANTS",
    "OBSERVERS",
    "SRGB_TO_XYZ",
    "Gamut",
    "channel_wavelengths",
    "cie_rgb",
    "cie_weights",
    "colour_error",
    "daylight_doubt",
    "daylight_lab",
    "decode_srgb",
    "delta_e_2000",
    "encode_srgb",
    "in_gamut",
    "lab",
    "out_of_gamut",
    "sampling_error",
    "stochastic_rgb",
    "stochastic_weights",
    "thesis_rgb",
    "thesis_weights",
    "to_rgb",
    "to_rgb_error",
    "write_exr",
    "write_png",
]
