"""Run whole tables without what takes half of their time: types checked at every call, rows composed at every look."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator

import jaxtyping
import pytest

from kinema.experiments import config


@pytest.fixture(scope="module")
def unchecked() -> Iterator[None]:
    """Stop the checks of tests/conftest.py for the tests of a file: what its tables run has tests of its own."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(scope="module", autouse=True)
def composed_once() -> Iterator[None]:
    """Compose the same overrides once though they have a search path: its files are those of `micro_tables`."""
    once = functools.cache(config._compose)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(config, "_compose", lambda overrides, name: copy.deepcopy(once(overrides, name)))
        yield
