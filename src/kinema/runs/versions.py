"""Name the software that computed a result."""

from __future__ import annotations

import contextlib
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def versions() -> dict[str, str]:
    """Return the versions of the packages and of Python, and the revision of the checkout."""
    found = {"python": platform.python_version()}
    for package in ("kinema", "torch", "lightning", "numpy", "transformers"):
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    root = Path(__file__).resolve().parents[3]
    if not (root / "pyproject.toml").exists():
        return found  # installed: git would answer for whatever repository site-packages happens to lie in
    with contextlib.suppress(OSError):
        answer = subprocess.run(["git", "-C", root, "describe", "--always", "--dirty"], capture_output=True, text=True)
        if answer.returncode == 0:
            found["revision"] = answer.stdout.strip()
    return found
