"""What stands around the code agrees with it: `make help`, locks, hooks, versions and the rooms of the reference."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import kinema
from kinema.experiments.config import CONF

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
BESIDE = ("docs", "demo")
"""Extras with a lock file of their own, which adds to the other."""


def locked(name: str) -> dict[str, str]:
    """Read the pins of a lock file."""
    pins = (line.split("==") for line in (ROOT / name).read_text().splitlines() if "==" in line)
    return {canonicalize_name(package): version for package, version in pins}


def test_make_help_lists_every_target_table_and_page_with_a_line():
    said = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    lines = dict(re.findall(r"^  (\S+) +(\S.*)$", said, re.MULTILINE))
    makefile = (ROOT / "Makefile").read_text()
    targets = re.findall(r"^([a-z][a-z0-9-]*):", makefile, re.MULTILINE)
    files = [*(CONF / "table").glob("*.yaml"), *(CONF / "page").glob("*.yaml")]
    titles = {f"reproduce-{f.stem}": yaml.safe_load(f.read_text())["title"] for f in files}
    assert set(lines) == {*targets, *titles}
    assert titles.items() <= lines.items()
    assert set(re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[0].split()) == set(targets)


@pytest.mark.parametrize("extra", ["", *(name for name in EXTRAS if name not in ("tag", "fbx"))])
def test_locks_pin_what_is_declared(extra):
    pins = locked("requirements.lock") | (locked(f"requirements-{extra}.lock") if extra in BESIDE else {})
    for text in EXTRAS[extra] if extra else PROJECT["dependencies"]:
        declared = Requirement(text)
        assert declared.specifier.contains(pins[canonicalize_name(declared.name)]), text


@pytest.mark.parametrize("extra", BESIDE)
def test_the_other_locks_add_to_the_lock_and_change_nothing(extra):
    assert not locked(f"requirements-{extra}.lock").keys() & locked("requirements.lock").keys()


def test_hooks_run_the_locked_linter():
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    assert set(re.findall(r"\bruff==([\d.]+)", hooks)) == {locked("requirements.lock")["ruff"]}


def test_one_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert {PROJECT["version"], citation["version"], newest[1]} == {kinema.__version__}
