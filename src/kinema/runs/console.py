"""Hold the console that runs report to, and keep what names and files hold from steering it."""

from __future__ import annotations

import re
from typing import Any

from rich.console import Console
from rich.text import Text

_STYLED = re.compile(r"\[(bold|red|yellow)\](.*?)\[/\]")
# Escape sequences move the cursor, rename windows, fill the clipboard; direction marks turn text around.
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    r"""Return the text with what would steer a terminal written out, an escape as \x1b."""
    return _STEERING.sub(lambda found: ascii(found[0])[1:-1], text)


class _Lines(Console):
    """Print lines whose first word may be styled, `[red]failed[/]    ...`; what follows is text as it is."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print."""
        super().print(*(_line(found) if isinstance(found, str) else found for found in objects), **options)


def _line(text: str) -> Text:
    text, style = printable(text), ""
    if found := _STYLED.match(text):
        style, word = found.groups()
        return Text.assemble((word, style), text[found.end() :])
    return Text(text)


console = _Lines(highlight=False, soft_wrap=True)
