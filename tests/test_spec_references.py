"""Every reference to a specification leads to a section of it: "MARDM §4", "BAD §6.5-6", "T2M-GPT, Tokenizer"."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from kinema.experiments.config import CONF, compose

ROOT = Path(__file__).resolve().parents[1]
SPECS = ROOT / "docs" / "specs"
SUFFIXES = {".py", ".yaml", ".md", ".toml"}
FILES = [ROOT / "README.md", ROOT / "pyproject.toml"]
FILES += [f for name in ("src", "conf", "docs", "tests", "benchmarks") for f in sorted((ROOT / name).rglob("*"))]
FILES = [f for f in FILES if f.suffix in SUFFIXES and f != Path(__file__).resolve()]  # this file makes some up

GAP = r"[\s#]+"  # a reference may go on in the next line, behind a comment's mark
NUMBER = r"\d+(?:\.\d+)?"
CHAIN = rf"§{NUMBER}(?:(?:[-–]§?|,{GAP}§|{GAP}(?:and|to){GAP}§){NUMBER})*"
NUMBERED = re.compile(rf"(?:(?P<name>[A-Za-z][\w-]*)(?:\.md)?:?{GAP})?(?P<chain>{CHAIN}|§)")
PAPERS = re.compile(r"(Figure|Tables?|Eq)\b")
"""What a paper has: "MARDM, Figure 2" is no section of a specification."""


@dataclass
class Spec:
    """Hold a specification's section numbers, and its titles with the numbers of the items below each."""

    numbers: set[str] = field(default_factory=set)
    titles: dict[str, set[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, text: str) -> Spec:
        """Index headings ("## §4 Training (...)", "### §4.2 ..."), and list items: item 2 of section 4 is 4.2."""
        spec, section, items = cls(), "", set()
        for line in re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL).splitlines():
            if heading := re.match(rf"(#+) (?:§({NUMBER}) )?(.*)", line):
                level, number, title = heading.groups()
                section = number or ("" if level == "##" else section)
                items = spec.titles.setdefault(re.split(r" *[(:/]", title)[0].lower(), set())
                spec.numbers |= {section} - {""}
            elif item := re.match(r"(\d+)\. ", line):
                items.add(item[1])
                spec.numbers |= {f"{section}.{item[1]}"} if section else set()
        return spec


def unresolved(text: str, specs: dict[str, Spec], own: str | None = None) -> tuple[int, list[str]]:
    """Count the references of a text, and list those that lead nowhere; `own` is the specification that it is."""
    count, lost = 0, []
    for found in NUMBERED.finditer(text):
        name = found["name"] if found["name"] in specs else own
        wanted = expand(found["chain"])
        count += 1
        if name is None or not wanted or not wanted <= specs[name].numbers:
            lost.append(" ".join(found[0].split()))
    if own is None:
        names = "|".join(sorted(map(re.escape, specs), key=len, reverse=True))
        for found in re.finditer(rf"(?<![\w-])({names}),{GAP}", text):
            rest = re.sub(GAP, " ", text[found.end() : found.end() + 80])
            resolved = leads_to_title(rest, specs[found[1]].titles)
            if resolved is None and re.match(r"[A-Z][a-z]+\b", rest) and not PAPERS.match(rest):
                resolved = re.match(rf"({names})(?![\w-])", rest) is not None  # "T2M-GPT, MotionGPT and ..."
            count += resolved is not None
            if resolved is False:
                lost.append(f"{found[1]}, {rest[:20]}")
    return count, lost


def expand(chain: str) -> set[str]:
    """Turn "§2-§4" into 2, 3, 4 and "§6.5-6" into 6.5, 6.6; nothing for a bare "§"."""
    wanted: set[str] = set()
    last = ""
    for joint, number in re.findall(rf"\s*([-–]|to\b)?[^\d]*({NUMBER})", chain):
        if joint:
            section, dot, first = last.rpartition(".")
            end = number.rpartition(".")[2]
            wanted |= {f"{section}{dot}{n}" for n in range(int(first), int(end) + 1)}
        wanted |= set() if joint and "." in last else {number}
        last = number
    return wanted


def leads_to_title(rest: str, titles: dict[str, set[str]]) -> bool | None:
    """Say whether "Training", "Training and Sampling" or "Generation 2" is there; None if no title is meant."""
    lower = rest.lower()
    found = [t for t in titles if t and re.match(rf"{re.escape(t)}(?!\w)", lower)]
    if not found:
        return None
    title = max(found, key=len)
    behind = rest[len(title) :]
    if item := re.match(r" (\d+)\b", behind):
        return item[1] in titles[title]
    if more := re.match(r" and (?=[A-Z])", behind):
        return leads_to_title(behind[more.end() :], titles) is True
    return True


@pytest.fixture(scope="module")
def specs() -> dict[str, Spec]:
    """Read all specifications."""
    return {file.stem: Spec.read(file.read_text()) for file in SPECS.glob("*.md") if file.stem != "README"}


def test_every_reference_leads_to_a_section(specs):
    total, lost = 0, []
    for file in FILES:
        own = file.stem if file.parent == SPECS and file.stem in specs else None
        count, missing = unresolved(file.read_text(), specs, own)
        total += count
        lost += [f"{file.relative_to(ROOT)}: {reference}" for reference in missing]
    assert not lost
    assert total > 200


def test_every_specification_is_listed(specs):
    listed = (SPECS / "README.md").read_text()
    assert not [name for name in specs if f"]({name}.md)" not in listed]


def test_options_that_a_specification_names_are_there():
    """Look `generator.model.words=all` up in the configuration of any method, and `text=clip_b32` among the files."""
    named = {o for file in SPECS.glob("*.md") for o in re.findall(r"`(\+?[a-z]+(?:\.\w+)*=[\w.]+)`", file.read_text())}
    methods = [f"method={file.stem}" for file in sorted((CONF / "method").glob("*.yaml"))]
    configs = [compose([method, "scale=paper"], "evaluate") for method in methods]
    absent = object()

    def is_there(option: str) -> bool:
        key, _, value = option.partition("=")
        if option.startswith("+"):
            return compose([option], "evaluate") is not None
        choice = (CONF / key / f"{value}.yaml").is_file()
        return choice or any(OmegaConf.select(cfg, key, default=absent) is not absent for cfg in configs)

    assert len(named) > 50
    assert not [option for option in sorted(named) if not is_there(option)]


INVENTED = Spec.read(
    """# NET
## §1 Data (all of it)
1. one
2. two
```
## §9 no heading
```
## §3 Loss
### §3.4 Its weight
## Training
1. first
## Loader policy
3. third
"""
)


@pytest.mark.parametrize(
    "text",
    [
        *("NET §1", "(NET §1, §3; more)", "NET §1.2 and NET §3.4", "NET.md §3", "NET: §3", "NET §1.1-2", "A-NET §2-§3"),
        *("x = 1  # as in NET\n    # §3", "(NET, Training)", "NET, Training 1", "NET, loader policy", "NET, Figure 7"),
        *("NET, Training and Loader policy", "the NET, A-NET and others", "NET, which is large", "NET, A-NET"),
    ],
)
def test_references_that_lead_somewhere(text):
    specs = {"NET": INVENTED, "A-NET": Spec({"2", "3"})}
    assert not unresolved(text, specs)[1]


@pytest.mark.parametrize(
    "text",
    [
        *("NET §2", "NET §9", "NET §1.3", "NET §3.1", "NET §1, §2", "NET §1-§3", "NET §1.2-3", "DESIGN §1", "(§1)"),
        *("MY-NET §1", "NET §", "see §1", "NET, Sampling", "NET, Training 2", "NET, Training and Sampling"),
        "NET,\n# Sampling",
    ],
)
def test_references_that_lead_nowhere(text):
    assert unresolved(text, {"NET": INVENTED})[1]


def test_a_specification_refers_to_itself_without_its_name():
    assert not unresolved("as §1 and §3.4 say", {"NET": INVENTED}, own="NET")[1]
    assert unresolved("as §2 says", {"NET": INVENTED}, own="NET")[1]
