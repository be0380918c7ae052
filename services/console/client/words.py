"""Numbers of things in words."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """The number and the noun, such as ``1 round`` or ``30 rounds``; the noun takes an s."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
