"""Share the fixtures: the reference folder and one thread, so that floats do not depend on the machine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parent.parent

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Give the reference folder (KINEMA_SHARED, default ../shared beside the checkout) or skip."""
    folder = Path(os.environ.get("KINEMA_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"reference folder {folder} is absent; set KINEMA_SHARED to run this test")
    return folder
