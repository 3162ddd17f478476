"""Share one tiny CLIP whose pooled vectors and words differ in width."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def tiny_clip(make_clip: Callable[[int, int], Path]) -> Path:
    return make_clip(32, 24)
