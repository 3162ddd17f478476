"""Share a tiny random model and its run folder, and a browser."""

from __future__ import annotations

from tests.browser.conftest import chromium
from tests.pipeline.conftest import model, parts, run

__all__ = ["chromium", "model", "parts", "run"]
