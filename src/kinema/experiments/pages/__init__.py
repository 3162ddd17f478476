"""Measure what no table shows: `kinema reproduce NAME` for a file of conf/page, carried out by the module NAME.

Pages of one kind name the module that makes them as their `author`.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, Protocol, cast

from omegaconf import OmegaConf

from kinema.experiments.config import CONF, compose, plain
from kinema.experiments.request import Request


class Author(Protocol):
    """Make one page: what the module of its name is."""

    def carry_out(self, page: dict[str, Any], request: Request) -> list[Path]:
        """Make what is missing unless `request.render_only`, measure, and write the page; returns what it wrote."""


def pages() -> list[str]:
    """Name the pages there are."""
    return sorted(path.stem for path in (CONF / "page").glob("*.yaml"))


def load_page(name: str) -> dict[str, Any]:
    """Read conf/page/NAME.yaml; what it has `at` a scale, by the scale's name, replaces the same keys there."""
    return {"name": name, **plain(OmegaConf.load(CONF / "page" / f"{name}.yaml"))}


def make_page(request: Request) -> list[Path]:
    """Carry out what a page asks for, and return what was written."""
    request.refuse_options_of_tables()
    page = load_page(request.name)
    if "at" in page:
        there = page["at"].get(compose(request.shared, "evaluate").scale.name, {})
        page = {key: value for key, value in page.items() if key != "at"} | there
    author = cast(Author, importlib.import_module(f"{__name__}.{page.get('author', request.name)}"))
    return author.carry_out(page, request)
