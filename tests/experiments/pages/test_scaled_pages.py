"""Test that a page may have less at a scale at which numbers mean nothing."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from kinema.experiments import pages
from kinema.experiments.request import Request


@pytest.mark.parametrize(("scale", "motions"), [("smoke", 2), ("tiny", 9)])
def test_what_a_page_has_at_a_scale_replaces_its_own(monkeypatch, scale, motions):
    seen: list[dict] = []
    page = {"name": "noise", "motions": 9, "batches": [1], "at": {"smoke": {"motions": 2}}}
    author = SimpleNamespace(carry_out=lambda page, request: seen.append(page) or [])
    monkeypatch.setattr(pages, "load_page", lambda name: dict(page))
    monkeypatch.setitem(sys.modules, "kinema.experiments.pages.noise", author)
    assert pages.make_page(Request("noise", ("data=synthetic", f"scale={scale}"))) == []
    assert seen == [{"name": "noise", "motions": motions, "batches": [1]}]
