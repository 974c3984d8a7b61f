"""The dashboard's colours as CSS variables: as they are on dark, darker on light until they can be seen.

WCAG 2.2, success criterion 1.4.11: a line needs a contrast of 3:1 against what is beside it.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterable

__all__ = ["LIGHT_BACKGROUND", "NEEDED_CONTRAST", "contrast", "on_light", "rgb", "style_sheet", "variable"]

LIGHT_BACKGROUND = 0xFFFFFF
NEEDED_CONTRAST = 3.2
"""The criterion asks for 3; a little more survives rounding to 8 bits and a light grey below the line."""


def rgb(rgba: int) -> int:
    """0xRRGGBB of the dashboard's 0xRRGGBBAA."""
    return rgba >> 8


def variable(rgba: int) -> str:
    """Name of the CSS variable of a colour of the dashboard."""
    return f"--c-{rgb(rgba):06x}"


def style_sheet(colors: Iterable[int], *, dark: bool) -> str:
    """Declarations of the variables of these colours (0xRRGGBBAA) for one theme."""
    kept = dict.fromkeys(colors)
    return " ".join(
        f"{variable(color)}: #{rgb(color) if dark else on_light(rgb(color)):06x};" for color in kept
    )


def on_light(color: int) -> int:
    """The colour of the same hue, 0xRRGGBB, dark enough for a white page."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(part / 255 for part in color.to_bytes(3, "big")))
    if saturation < 0.2:
        lightness = min(lightness, 1.0 - 0.9 * lightness)
    found = _packed(hue, lightness, saturation)
    while contrast(found, LIGHT_BACKGROUND) < NEEDED_CONTRAST:
        lightness -= 0.01
        found = _packed(hue, lightness, saturation)
    return found


def contrast(one: int, other: int) -> float:
    """Contrast ratio of two colours 0xRRGGBB, 1 to 21 (WCAG 2.2, definition of contrast ratio)."""
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def _packed(hue: float, lightness: float, saturation: float) -> int:
    parts = colorsys.hls_to_rgb(hue, max(0.0, lightness), saturation)
    return int.from_bytes(bytes(round(part * 255) for part in parts), "big")


def _luminance(color: int) -> float:
    linear = []
    for byte in color.to_bytes(3, "big"):
        part = byte / 255
        linear.append(part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4)
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
