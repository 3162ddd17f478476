"""What is built to be installed: the package with its configurations and nothing else, working from any directory."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from kinema.pipeline import models

ROOT = Path(__file__).resolve().parents[1]
BUILD = "from setuptools import build_meta as b; b.build_wheel('dist'); b.build_sdist('dist')"
LITTER = shutil.ignore_patterns("__pycache__", "*.egg-info", "conf")


def files(folder: Path) -> set[str]:
    """Name the files of a folder, without what Python leaves there."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    return {p.as_posix() for p in found if "__pycache__" not in p.parts}


@pytest.fixture(scope="session")
def built(tmp_path_factory) -> Path:
    """Build wheel and sdist from a copy of the checkout, and return the folder that holds both."""
    copy = tmp_path_factory.mktemp("checkout")
    for path in (p for p in ROOT.iterdir() if p.is_file()):
        shutil.copy(path, copy)
    shutil.copytree(ROOT / "conf", copy / "conf")
    for name in ("src", "tests", "docs"):
        shutil.copytree(ROOT / name, copy / name, ignore=LITTER)
    stale = copy / "build" / "lib" / "kinema" / "conf" / "method" / "gone.yaml"  # of a build before
    stale.parent.mkdir(parents=True)
    stale.touch()
    done = subprocess.run([sys.executable, "-c", BUILD], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return copy / "dist"


def test_the_wheel_is_the_package_and_its_configurations(built):
    (wheel,) = built.glob("*.whl")
    names = {n for n in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in n}
    rooms = ("kinema", "hydra_plugins")  # the second is where Hydra looks for launchers
    assert names == {f"{room}/{name}" for room in rooms for name in files(ROOT / "src" / room)} | {
        f"kinema/conf/{name}" for name in files(ROOT / "conf")
    }


def test_the_package_has_its_model():
    """Other tests skip without it; this one says that it has to be added (`kinema pack RUN --out ... --half`)."""
    (model,) = models.shipped()
    assert model.name == models.DEFAULT
    assert model.size <= 12_000_000
    assert (model.card.half, model.card.licence) == (True, "CC BY-NC 4.0")
    assert {"kinema train", "kinema pack"} == {" ".join(command.split()[:2]) for command in model.card.commands}
    assert {"val", "test"} == {one["split"] for one in model.card.figures}
    assert not [value for value in str(model.card).split() if value.startswith("/")]  # no path of a machine


def test_the_sdist_builds_the_same_and_carries_neither_tests_nor_results(built, tmp_path):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    assert {p.name for p in source.iterdir() if p.is_dir()} == {"src", "conf"}
    assert files(source / "conf") == files(ROOT / "conf")
    subprocess.run([sys.executable, "-c", BUILD], cwd=source, capture_output=True, check=True)
    (again,), (wheel,) = (folder.glob("*.whl") for folder in (source / "dist", built))
    assert set(zipfile.ZipFile(again).namelist()) == set(zipfile.ZipFile(wheel).namelist())


@pytest.fixture(scope="session")
def empty(tmp_path_factory) -> Path:
    """Return the empty folder in which an installed kinema is tried."""
    return tmp_path_factory.mktemp("empty")


@pytest.fixture(scope="session")
def installed(built, empty, tmp_path_factory) -> Callable[..., subprocess.CompletedProcess]:
    """Install the wheel into an environment that sees this one's libraries; run its `kinema` in the empty folder."""
    folder = tmp_path_factory.mktemp("installed")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    scheme = sysconfig.get_preferred_scheme("prefix")
    place = {"base": str(folder / "venv"), "platbase": str(folder / "venv")}
    site, scripts = (Path(sysconfig.get_path(name, scheme, vars=place)) for name in ("purelib", "scripts"))
    (site / "libraries.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", shutil.which("python", path=scripts)]
    subprocess.run([*pip, "install", "--quiet", "--no-index", "--no-deps", wheel], check=True)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH" and not k.startswith("KINEMA_")}
    environment |= {"OMP_NUM_THREADS": "1"}

    def run(*words: str) -> subprocess.CompletedProcess:
        kinema = shutil.which("kinema", path=scripts)
        done = subprocess.run(
            [kinema, *words], cwd=empty, env=environment, capture_output=True, text=True, errors="replace"
        )
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
        return done

    return run


def test_an_installed_kinema_composes_its_own_configurations(installed, empty):
    for job, group in (("train", "stage: generator"), ("evaluate", "source: generation")):
        composed = installed(job, "--cfg", "job", "method=mardm_ddpm", "scale=tiny").stdout
        assert f"{group}\n" in composed
        assert str(ROOT) not in composed
    assert not list(empty.iterdir())


@pytest.mark.slow
def test_an_installed_kinema_trains_scores_and_reports(installed, empty, micro, micro_tables):
    """Run the commands of the experiments far from any checkout."""
    here = [o for o in micro_tables if not o.startswith("paths.runs")]
    assert "done " in installed("train", "stage=tokenizer", *here).stdout
    assert len(list(empty.glob("runs/tokenizer/*/weights.safetensors"))) == 1
    assert "no complete results for: " in installed("reproduce", "table5", *here, "--render-only").stdout
    assert (empty / "reports" / "table5" / "index.html").exists()
    assert "real" in installed("evaluate", "source=real", *micro).stdout
    installed("figures", "bad_masks")
    assert (empty / "reports" / "bad_masks" / "bad_masks.txt").exists()
    assert {p.name for p in empty.iterdir()} == {"reports", "runs"}


@pytest.mark.slow
def test_an_installed_kinema_makes_motion_far_from_any_corpus_or_network(installed, shipped, empty):
    installed("generate", "a person waves with the left hand", "--out", "wave.html")
    assert (empty / "wave.html").stat().st_size > 10_000
    assert "latent-flow-open-mocap" in installed("models").stdout
    (empty / "wave.html").unlink()
