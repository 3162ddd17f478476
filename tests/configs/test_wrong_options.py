"""Feed every option of the configuration wrong kinds of values: each is one line that names the option, or is right.

Nothing is listed by hand: what composed configurations describe is walked, and of each class all arguments.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import DictConfig, OmegaConf

from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.experiments.config import CONF, compose, plain, validate
from kinema.experiments.stages import stages
from kinema.experiments.training import make_recipe
from kinema.runs.build import build, locate

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
    list: WRONG.keys() - {"list"},
    dict: WRONG.keys() - {"mapping", "null"},
    type(None): NEVER - {"list"},
}
"""The kinds that must be refused where a value of this type stands."""
FREE = {"trainer.extra", "data.options"}
"""Mappings that go on to a library or a reader, and are checked there."""


def options_of(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


@cache
def composed(*overrides: str) -> DictConfig:
    return compose([*overrides, "data=synthetic", "text=hashed", "evaluator.words=hashed"], "evaluate")


@cache
def configs() -> list[DictConfig]:
    """Compose every method, and every tokenizer with the method that it fits."""
    found = [composed(f"method={method}") for method in options_of("method")]
    return found + [composed(f"tokenizer={tokenizer}") for tokenizer in options_of("tokenizer")]


def specs(node: Any) -> Iterator[dict[str, Any]]:
    """Walk the specs in a plain configuration, the inner ones first."""
    inner = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    for value in inner:
        yield from specs(value)
    if isinstance(node, dict) and "_target_" in node:
        yield node


@cache
def described() -> dict[str, dict[str, Any]]:
    """Find one spec of each class that a configuration describes, with what its stage adds."""
    found: dict[str, dict[str, Any]] = {}
    for cfg in configs():
        models = [stage.spec(cfg) for stage in stages().values() if hasattr(stage, "spec") and stage.present(cfg)]
        for spec in specs(models):
            found.setdefault(f"{locate(spec['_target_']).__module__}.{locate(spec['_target_']).__name__}", spec)
    return found


def ask(key: str, kind: str, standing: Any, make: Callable[[], Any]) -> None:
    """Try one wrong value: one line that names the option, or, where that can be right, an object."""
    try:
        make()
    except ValueError as error:
        message = str(error)
        assert key in message, message
        assert "\n" not in message
        assert len(message) < 500
    else:
        assert kind not in REFUSED[type(standing)], f"{key} of {standing!r} takes {kind}: {WRONG[kind]!r}"


def standing_value(parameter: inspect.Parameter, spec: dict[str, Any]) -> Any:
    value = spec.get(parameter.name, parameter.default)
    return list(value) if isinstance(value, tuple) else value


TARGETS = sorted(described())


def test_all_families_are_described():
    families = {target.split(".")[1] for target in TARGETS}
    assert families == {"diffusion", "evaluation", "generators", "motion", "tokenizers"}
    assert len(TARGETS) > 30


@pytest.mark.parametrize("target", TARGETS)
def test_no_argument_of_a_class_takes_what_is_wrong(target):
    spec = described()[target]
    parameters = inspect.signature(locate(target)).parameters.values()
    for parameter in parameters:
        standing = standing_value(parameter, spec)
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) or parameter.name == "pkeep":
            continue
        for kind, value in WRONG.items():
            with torch.device("meta"):
                ask(parameter.name, kind, standing, lambda: build({**spec, parameter.name: value}, at="here"))


@pytest.fixture(scope="module")
def store(shelf: Path) -> PackedStore:
    return PackedStore.open(prepare_store("synthetic", None, shelf / "stores", name="options", size=40))


RECIPES = {
    stage.node: plain(stage.config(cfg))["train"]
    for cfg in configs()
    for stage in stages().values()
    if stage.present(cfg) and plain(stage.config(cfg)).get("train")
}


@pytest.mark.parametrize("node", sorted(RECIPES))
def test_no_field_of_a_recipe_takes_what_is_wrong(node, store):
    for name, standing in RECIPES[node].items():
        for kind, value in WRONG.items():
            ask(
                f"{node}.train.{name}",
                kind,
                standing,
                lambda: make_recipe({**RECIPES[node], name: value}, store, at=f"{node}.train"),
            )


def leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Walk the values of the groups that describe no model."""
    for name, value in node.items():
        inner = f"{key}.{name}" if key else name
        if inner in FREE or not isinstance(value, dict):
            yield inner, value
        elif "_target_" not in value and name not in ("model", "train", "sampling", "spec", "diffusion", "hydra"):
            yield from leaves(value, inner)


GROUPS = dict(leaves(plain(composed())))
UNREAD = ("budget",)


@pytest.mark.parametrize("group", sorted({key.partition(".")[0] for key in GROUPS}))
def test_no_key_of_a_group_takes_what_is_wrong(group):
    for key, standing in GROUPS.items():
        for kind, value in WRONG.items() if key.partition(".")[0] == group else ():
            cfg = composed().copy()
            OmegaConf.update(cfg, key, value)
            ask(key.rpartition(".")[2] if key.startswith(tuple(FREE)) else key, kind, standing, lambda: validate(cfg))
