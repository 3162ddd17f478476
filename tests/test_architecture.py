"""Hold the import edges, the size of files, and that asking for help pays for nothing."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "kinema"
MODULES = {
    ".".join(file.relative_to(ROOT / "src").with_suffix("").parts).removesuffix(".__init__"): file
    for file in sorted(PACKAGE.rglob("*.py"))
}
MOST_LINES = 350

FOUNDATION = {
    "types",
    "options",
    "atomic",
    "files",
    "locks",
    "seeds",
    "signals",
    "devices",
    "registry",
    "nn",
    "masking",
}
MODEL = {*FOUNDATION, "motion", "diffusion", "decoding"}
MAY_IMPORT = {
    # `types, nn, masking -> diffusion, decoding -> tokenizers, generators -> runs -> pipeline -> evaluation -> training
    # -> experiments -> cli`; `motion -> data`; motion is open to all (a joint loss needs recovery), and so are
    "types": set(),
    "options": set(),
    "atomic": set(),
    "files": set(),
    "locks": set(),
    "seeds": {"options"},
    "signals": set(),
    "devices": set(),
    "registry": set(),
    "masking": {"types"},
    "nn": {"types", "masking"},
    "motion": {"types", "options", "atomic", "files", "registry"},
    "data": {"types", "options", "atomic", "files", "locks", "seeds", "motion"},
    "text": {"types", "options", "atomic", "files", "locks", "seeds"},
    "diffusion": FOUNDATION,
    "decoding": {*FOUNDATION, "diffusion"},
    "tokenizers": MODEL,
    "generators": {*MODEL, "text", "tokenizers"},
    "runs": {"options", "atomic", "files", "locks", "registry", "signals"},
    "report": {"types", "atomic", "files", "motion"},
}
MAY_IMPORT["pipeline"] = {*MODEL, "text", "tokenizers", "generators", "runs"}
MAY_IMPORT["demo"] = {*MAY_IMPORT["pipeline"], "pipeline"}
MAY_IMPORT["evaluation"] = {*MAY_IMPORT["pipeline"], "pipeline", "data"}
MAY_IMPORT["interop"] = {*MAY_IMPORT["evaluation"], "evaluation"}
MAY_IMPORT["training"] = {*MAY_IMPORT["evaluation"], "evaluation"}
MAY_IMPORT["experiments"] = {*MAY_IMPORT["training"], "training", "report"}
MAY_IMPORT["cli"] = {*MAY_IMPORT["experiments"], "experiments", "interop", "demo"}


def imports(file: Path) -> set[str]:
    """Give the modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def rooms(file: Path) -> set[str]:
    """Give the parts of kinema that a file imports."""
    parts = {name.split(".")[1] for name in imports(file) if name.startswith("kinema.")}
    return {part for part in parts if (PACKAGE / part).is_dir() or (PACKAGE / f"{part}.py").exists()}


@pytest.mark.parametrize("module", [name for name in MODULES if "." in name])
def test_a_part_imports_what_lies_left_of_it(module):
    own = module.split(".")[1]
    assert own in MAY_IMPORT, f"{module} is a new part: give it its place among the edges"
    strays = rooms(MODULES[module]) - MAY_IMPORT[own] - {own}
    assert not strays, f"{module} imports {', '.join(sorted(strays))}"


def loads(file: Path) -> set[str]:
    """Give the modules of kinema whose code must have run before that of a file: its imports outside functions."""
    found, waiting = set(), list(ast.parse(file.read_text()).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inner = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in inner.values()}
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not for_types_only(node):
            waiting += ast.iter_child_nodes(node)
    return found & MODULES.keys()


def for_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def test_imports_make_no_cycle():
    graph = {module: loads(file) for module, file in MODULES.items()}
    assert sum(map(len, graph.values())) > len(graph)
    assert graph["kinema.text.encoders"] >= {"kinema.text.clip", "kinema.text.hashed"}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules


@pytest.mark.parametrize(
    ("library", "where"),
    [
        (("lightning", "pytorch_lightning"), ("kinema.data.datamodule", "kinema.training")),
        (("hydra", "omegaconf"), ("kinema.experiments",)),
    ],
)
def test_frameworks_stay_in_their_rooms(library, where):
    for module, file in MODULES.items():
        if {name.split(".")[0] for name in imports(file)} & set(library):
            assert module.startswith(where), f"{module} imports {library[0]}"


def test_every_folder_is_a_package():
    """A folder without __init__.py (one that git ignores, say) would miss a room and its docstring."""
    assert {file.parent for file in PACKAGE.rglob("*.py")} == {file.parent for file in PACKAGE.rglob("__init__.py")}


def test_files_are_short():
    files = [*ROOT.glob("*.py"), *ROOT.glob("src/**/*.py"), *ROOT.glob("tests/**/*.py"), *ROOT.glob("benchmarks/*.py")]
    lengths = {str(f.relative_to(ROOT)): len(f.read_text().splitlines()) for f in files}
    long = {name: n for name, n in lengths.items() if n > (MOST_LINES if name.startswith("src") else 2 * MOST_LINES)}
    assert not long


@pytest.mark.parametrize(
    "command",
    [["train.py"], ["evaluate.py"], *(["-m", "kinema.cli", *words] for words in ([], ["train"], ["evaluate"]))],
    ids=["train.py", "evaluate.py", "kinema", "kinema train", "kinema evaluate"],
)
def test_help_imports_neither_torch_nor_lightning(command):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *command, "--help"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    imported = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines() if line.startswith("import time")}
    assert len(imported) > 50
    assert not {"torch", "lightning", "transformers"} & imported
    assert done.stdout
