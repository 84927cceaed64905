"""Numbers and sentences as print has them."""

from __future__ import annotations

import re
from typing import Any

NARROW = "\u202f"  # a narrow space at which no line breaks
MINUS, DASH = "−", "–"


def typeset(text: str) -> str:
    """Powers of ten, minus signs, per cent and Greek letters as on paper, and numbers that hold together."""
    kind = type(text)  # markup stays markup
    text = re.sub(r"(\d(?:\.\d+)?)e([+-]\d+)", lambda m: f"{m[1]}{NARROW}×{NARROW}10{raised(int(m[2]))}", text)
    text = re.sub(r"(?<![\w)])-(?=\d)", "−", text)
    for word, letter in (("gamma", "γ"), ("alpha", "α"), ("lambda", "λ"), ("sigma", "σ")):
        text = re.sub(rf"\b{word}\b", letter, text)
    text = re.sub(r" (±|×|×/÷) (?=\d)", "\u00a0\\1\u00a0", text)  # no line breaks within a number
    text = text.replace("×/÷", "×/\u2060÷")
    return kind(text.replace(" %", NARROW + "%"))


def raised(exponent: int) -> str:
    """``exponent`` in superior figures."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def anchor(name: str) -> str:
    """``Table 10`` as ``table-10``."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def short(value: Any, digits: int = 4) -> str:
    """A number in few digits, thousands apart; a dash for none."""
    if value is None:
        return DASH
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    return f"{value:.{digits}g}".replace("-", MINUS)


def written(value: float) -> str:
    """As the paper writes it: 300, 0.04, −0.1, 5 × 10⁶, 10⁻⁴."""
    size = abs(value)
    if 0.001 <= size < 1e5:
        return f"{value:g}".replace("-", MINUS)
    digits, _, exponent = f"{value:e}".partition("e")
    power = "10" + raised(int(exponent))
    factor = f"{float(digits):g}".replace("-", MINUS)
    return power if factor == "1" else f"{factor} × {power}"


def percent(value: float) -> str:
    """A fraction in per cent, with two digits below 10 %."""
    return f"{100 * value:.2g} %" if value < 0.0995 else f"{100 * value:.0f} %"
