"""Write names and labels, which may hold anything, as plain text in Markdown, LaTeX and spreadsheets."""

from __future__ import annotations

import re

_TEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_TEX |= {letter: f"\\{letter}" for letter in "&%$#_{}"}
_FORMULA = ("=", "+", "-", "@")


def one_line(text: object) -> str:
    """Return the text without line ends and other control characters: it ends no comment, row or heading."""
    return re.sub(r"[\s\x00-\x1f\x7f-\x9f\u2028\u2029]+", " ", str(text)).strip()


def markdown(text: object) -> str:
    """Return the text as Markdown that shows it: no HTML, no link, no image."""
    return re.sub(r"<(?=[a-zA-Z/!?])", "&lt;", one_line(text)).replace("](", "]\\(")


def code(text: object) -> str:
    """Return the text for a Markdown code span, which a backtick would end."""
    return one_line(text).replace("`", "'")


def tex(text: object) -> str:
    """Return the text as LaTeX that shows it."""
    return "".join(_TEX.get(letter, letter) for letter in one_line(text))


def spreadsheet(text: object) -> str:
    """Return the text as a cell that no spreadsheet takes for a formula."""
    line = one_line(text)
    return f"'{line}" if line.startswith(_FORMULA) else line
