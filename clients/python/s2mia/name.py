"""Names that can be shown on a terminal, and texts of peers made fit for it, by the rules of proto/src/name.rs."""

import unicodedata

LONGEST = 128
"""Longest name, bytes."""
INVISIBLE = (
    (0xAD, 0xAD),
    (0x34F, 0x34F),
    (0x61C, 0x61C),
    (0x115F, 0x1160),
    (0x17B4, 0x17B5),
    (0x180B, 0x180F),
    (0x200B, 0x200F),
    (0x202A, 0x202E),
    (0x2060, 0x206F),
    (0x2800, 0x2800),
    (0x3164, 0x3164),
    (0xFE00, 0xFE0F),
    (0xFEFF, 0xFEFF),
    (0xFFA0, 0xFFA0),
    (0xFFF0, 0xFFFB),
    (0x1BCA0, 0x1BCA3),
    (0x1D173, 0x1D17A),
    (0xE0000, 0xE0FFF),
)
"""First and last characters of ranges that are not visible, or change how the text around them is shown."""


def check(name: str, what: str) -> None:
    """Raises `ValueError`, which begins with `what`, unless the name is one short line that shows all its characters."""
    if not isinstance(name, str):
        raise ValueError(f"{what} has the type {type(name).__name__}; it is a text")
    size = len(name.encode())
    hidden = next((character for character in name if _is_invisible(character)), None)
    if not name:
        raise ValueError(f"{what} is empty")
    if size > LONGEST:
        raise ValueError(f"{what} has {size} bytes, at most {LONGEST} are allowed")
    if hidden is not None:
        raise ValueError(f"{what} has the invisible character U+{ord(hidden):04X}")
    if name != name.strip(" "):
        raise ValueError(f"{what} begins or ends with a space")


def printable(text: str) -> str:
    """The text as one line; an invisible character becomes its number."""
    line = " ".join(text.split())
    return "".join(f"<U+{ord(character):04X}>" if _is_invisible(character) else character for character in line)


def _is_invisible(character: str) -> bool:
    is_space = character.isspace() and character != " "
    within = any(first <= ord(character) <= last for first, last in INVISIBLE)
    return within or is_space or unicodedata.category(character) == "Cc"
