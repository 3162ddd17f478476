"""Feed every option of the configuration wrong kinds of values: each is one line that names the option, or is right.

Nothing is listed by hand: what composed configurations describe is walked, and of each class all arguments.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig, OmegaConf

from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.experiments.config import CONF, compose, plain, validate
from kinema.experiments.groups import GROUPS
from kinema.experiments.stages import judges
from kinema.experiments.training import Budget, make_recipe
from kinema.registry import find_class
from kinema.runs.build import build
from kinema.training.recipe import Recipe

WRONG: dict[str, Any] = {
    "text": "high",
    "number as text": "2",
    "list": [1, 2],
    "mapping": {"a": 1},
    "null": None,
    "nan": math.nan,
    "infinity": math.inf,
    "bool": True,
    "fraction": 2.5,
    "negative": -1,
    "huge": 10**9,
}
TEXTS, NUMBERS = {"text", "number as text"}, {"fraction", "negative", "huge"}
NEVER = {"list", "mapping", "nan", "infinity"}
"""What no single value may be."""
REFUSED = {
    int: WRONG.keys() - {"huge", "null"},
    float: NEVER | TEXTS | {"bool"},
    bool: WRONG.keys() - {"bool"},
    str: NEVER | NUMBERS | {"bool"},
    tuple: WRONG.keys() - {"list"},
    list: WRONG.keys() - {"list"},
    dict: WRONG.keys() - {"mapping", "null"},
    type(None): NEVER - {"list"},
}
"""The kinds that must be refused where a value of this type stands."""
FREE = {"trainer.extra", "data.options"}
"""Mappings that go on to a library or a reader, and are checked there."""
MODELS = {"model", "train", "sampling", "spec", "diffusion", "hydra", "budget"}
ALSO = {
    "pkeep": {"negative"},  # -1: drawn anew
    "solver_steps": {"number as text"},  # a count as one of "15,15,8"
    "devices": {"number as text", "negative", "list"},  # Lightning's
    "fps": {"fraction"},
}
"""Options that take more than what stands there is one of."""


def options_of(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


@cache
def composed(*overrides: str) -> DictConfig:
    return compose([*overrides, "data=synthetic", "text=hashed", "evaluator.words=hashed"], "evaluate")


def specs(node: Any) -> Iterator[dict[str, Any]]:
    """Walk the specs in a plain configuration, the inner ones first."""
    for value in node.values() if isinstance(node, dict) else ():
        yield from specs(value)
    if isinstance(node, dict) and "_target_" in node:
        yield node


def ask(key: str, kind: str, standing: Any, make: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """Try one wrong value: one line that names the option, or, where that can be right, an object."""
    try:
        make(*arguments, **options)
    except ValueError as error:
        message = str(error)
        assert key in message, message
        assert "\n" not in message
        assert len(message) < 500
    else:
        refused = REFUSED[type(standing)] - ALSO.get(key.rpartition(".")[2], set())
        assert kind not in refused, f"{key} of {standing!r} takes {kind}: {WRONG[kind]!r}"


def try_all(spec: dict[str, Any]) -> None:
    """Try every argument of the class that a spec names, those too that the spec leaves out."""
    for name, parameter in inspect.signature(find_class(spec["_target_"])).parameters.items():
        standing = spec.get(name, parameter.default)
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        for kind, value in WRONG.items():
            ask(name, kind, standing, build, spec | {name: value})


@pytest.mark.parametrize("method", options_of("method"))
def test_no_argument_of_a_method_takes_what_is_wrong(method):
    cfg = composed(f"method={method}")
    for node in ("generator", "residual", "shortcut", "length"):
        for spec in specs(plain(cfg[node])):
            try_all(spec)


@pytest.mark.parametrize("tokenizer", options_of("tokenizer"))
def test_no_argument_of_a_tokenizer_takes_what_is_wrong(tokenizer):
    for spec in specs(plain(composed(f"tokenizer={tokenizer}").tokenizer)):
        try_all(spec)


@pytest.mark.parametrize("stage", judges().values(), ids=judges())
def test_no_argument_of_a_judge_takes_what_is_wrong(stage):
    for spec in specs(stage.spec(composed())):
        try_all(spec)


@pytest.fixture(scope="module")
def store(shelf: Path) -> PackedStore:
    return PackedStore.open(prepare_store("synthetic", None, shelf / "stores", name="options", size=40))


@pytest.mark.parametrize("recipe", options_of("recipe"))
def test_no_field_of_a_recipe_takes_what_is_wrong(recipe, store):
    train = {"steps": 10, **plain(composed(f"recipe@generator.train={recipe}").generator.train)}
    for name in {field.name for kind in (Budget, Recipe) for field in fields(kind)}:
        for kind, value in WRONG.items():
            ask(f"x.train.{name}", kind, train.get(name), make_recipe, train | {name: value}, store, at="x.train")


def leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Walk the values of the groups that describe no model, and of parts that the method has."""
    for name, value in node.items():
        inner = f"{key}.{name}" if key else name
        if inner in FREE or not isinstance(value, dict):
            yield inner, value
        elif "_target_" not in value and name not in MODELS and value.get("model", "") is not None:
            yield from leaves(value, inner)


NAMES = sorted({key.partition(".")[0] for key in GROUPS})


@pytest.mark.parametrize("group", [*NAMES, "others"])
def test_no_key_of_a_group_takes_what_is_wrong(group):
    for key, standing in leaves(plain(composed())):
        own = key.partition(".")[0]
        for kind, value in WRONG.items() if (own if own in NAMES else "others") == group else ():
            cfg = composed().copy()
            OmegaConf.update(cfg, key, value, merge=False)
            ask(key, kind, standing, validate, cfg)
