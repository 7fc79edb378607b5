"""Rendered aerial photos of a solar park, with the truth about what is wrong with its modules.

All chance comes from seeds; one version of OpenCV makes the same bytes of them every time.
"""

from upwash.services.solar_park.geometry import Park, Rates
from upwash.services.solar_park.photo import (
    LABELS,
    RenderedPhoto,
    TrueBox,
    View,
    grey_photo,
    photograph,
    render_photo,
)

__all__ = [
    "LABELS",
    "Park",
    "Rates",
    "RenderedPhoto",
    "TrueBox",
    "View",
    "grey_photo",
    "photograph",
    "render_photo",
]
