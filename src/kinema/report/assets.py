"""Read the styles and scripts of reports."""

from __future__ import annotations

from importlib import resources


def asset(name: str) -> str:
    """Return the text of a file of this package."""
    return resources.files("kinema.report").joinpath(name).read_text(encoding="utf-8")
