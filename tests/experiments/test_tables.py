"""A table is its rows' replications: the same bytes twice, nothing shown of incomplete rows, only gaps recomputed."""

from __future__ import annotations

import csv
import json
from itertools import product
from pathlib import Path

import pytest

from kinema.data.leakage import CAPTION, FRAMES, TAKE
from kinema.data.synthetic import synthetic_clips, write_joints_folder
from kinema.experiments import evaluation, reproduce, table_files, tables
from kinema.experiments.benchmark import benchmark_columns, sections
from kinema.experiments.config import CONF, compose
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.jobs import Job, JobsFailedError, missing_jobs
from kinema.experiments.multirun import run_multiruns, steps, sweeps
from kinema.experiments.provenance import provenance
from kinema.experiments.request import Request
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import TableRow, meant_for, plan, render_table, with_borrowed
from kinema.report.cells import grid

pytestmark = pytest.mark.usefixtures("unchecked")

FILES = ("table.md", "table.csv", "table.tex", "table.json", "index.html")
COMMAND = "make reproduce-table5"


@pytest.fixture(scope="module")
def table() -> dict:
    return load_table("table5")


@pytest.fixture(scope="module")
def complete(micro_tables, table):
    """Run everything of table 5 once."""
    # The revision in the provenance changes when somebody commits meanwhile.
    patch = pytest.MonkeyPatch()
    patch.setattr(evaluation, "versions", lambda: {"python": "3"})
    for row in plan(table, micro_tables):
        if row.cfg is not None:
            run_evaluation(row.cfg)
    yield
    patch.undo()


def rendered(table, micro_tables, out: Path) -> dict[str, str]:
    render_table(table, plan(table, micro_tables), out, COMMAND)
    return {name: (out / name).read_text() for name in FILES}


def row_of(text: str, key: str) -> dict[str, str]:
    return next(line for line in csv.DictReader(text.splitlines()) if line["key"] == key)


def replications(table, micro_tables, key: str) -> Path:
    return (
        next(row for row in plan(table, micro_tables) if row.spec["key"] == key).place.folder.path
        / "replications.jsonl"
    )


@pytest.fixture
def gap(complete, table, micro_tables, tmp_path):
    """Delete the second result line of MARDM-SiT; gives its file, the line and the other tables' text before."""
    before = rendered(table, micro_tables, tmp_path / "before")
    path = replications(table, micro_tables, "mardm_sit")
    whole = path.read_text()
    lines = whole.splitlines(keepends=True)
    path.write_text("".join(x for x in lines if json.loads(x)["replication"] != 1))
    yield path, lines, before
    path.write_text(whole)


def test_rendering_twice_gives_the_same_bytes(complete, table, micro_tables, tmp_path):
    first, second = (rendered(table, micro_tables, tmp_path / name) for name in ("first", "second"))
    assert first == second
    assert row_of(first["table.csv"], "mardm_sit")["replications"] == "2"
    assert float(row_of(first["table.csv"], "real")["fid"]) == pytest.approx(0, abs=1e-3)
    assert float(row_of(first["table.csv"], "halves")["fid"]) > 0
    assert row_of(first["table.csv"], "halves")["r1"] == ""  # a row of one metric


def test_the_benchmark_stands_below_every_table(complete, table, micro_tables, tmp_path):
    text = rendered(table, micro_tables, tmp_path)["table.md"]
    section = text.split("## Benchmark\n\n")[1].split("\n\n")[0].splitlines()
    labels = [column["label"] for column in benchmark_columns()]
    assert [heading.strip(" ↑↓→") for heading in section[0].split("|")[3:-1]] == labels
    cells = {line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[3:-1]] for line in section[2:]}
    assert "MARDM-SiT" in cells
    assert "Real half against half" not in cells  # a row of one metric
    for label, row in cells.items():
        assert not {"", "–"} & set(row), label
    assert cells["Real motion"][0].startswith("1.000")


@pytest.mark.parametrize("name", sorted(file.stem for file in (CONF / "table").glob("*.yaml")))
def test_no_column_stands_twice(name):
    described = load_table(name)
    keys = [c["key"] for c in (*described["columns"], *described.get("beside", []), *benchmark_columns())]
    assert sorted(keys) == sorted(set(keys))


def test_rows_that_were_scored_before_the_benchmark_leave_it_empty():
    rows = [{"key": key, "label": key, "kind": "method", "note": ""} for key in "abcd"]
    results = [[{"jitter": 1.0, "fid": 2.0}], [{"jitter": 3.0, "coverage": 0.5}], [{"fid": 1.0}], []]
    filled = [{**row, "results": found} for row, found in zip(rows, results, strict=True)]
    none, section = sections([], filled)
    assert none["rows"] == []
    assert [row["key"] for row in section["rows"]] == ["a", "b"]
    lines = grid(section).lines
    at = [column["key"] for column in benchmark_columns()].index("coverage")
    assert [line.cells[at].ours is None for line in lines] == [True, False]


def test_methods_that_are_missing_say_so(complete, table, micro_tables, tmp_path):
    missing = [row["label"] for row in table["rows"] if "source" not in row]
    text = rendered(table, micro_tables, tmp_path)["table.md"]
    for label in missing:
        assert f"| {label} | not in Kinema yet |" in text
    assert text.count("not in Kinema yet |") == len(missing)
    assert "not yet run" not in text


def test_the_table_names_what_it_rests_on(complete, table, micro_tables, tmp_path):
    text = rendered(table, micro_tables, tmp_path)["table.md"]
    row = plan(table, micro_tables)[0].place
    provenance = row.lines[0]["provenance"]
    for fact in (provenance["corpus"]["hash"], *provenance["evaluators"].values(), *provenance["runs"].values()):
        assert str(fact) in text
    assert "hashed" in text
    assert COMMAND in text
    # Nothing of HumanML3D may stand beside another corpus' numbers unsaid.
    assert "synthetic" in text.split("|")[0]


def test_clips_are_told_apart_by_captions_that_training_has(complete, table, micro_tables):
    for line in plan(table, micro_tables)[0].place.lines:
        # A generated corpus repeats no sentence and has no takes.
        assert {value: part["n"] for value, part in line["breakdowns"][CAPTION].items()} == {
            "unseen": line["metrics"]["n"]
        }
        assert not {TAKE, FRAMES} & line["breakdowns"].keys()


def test_a_corpus_of_no_paper_stands_beside_the_panel_of_its_skeleton(micro_tables, tmp_path):
    """KIT's numbers, and its MDM of 1000 steps, for a corpus on the skeleton of KIT-ML."""
    described = load_table("table5")
    shown = {}
    for corpus in ("synthetic", "synthetic_kit"):
        rows = plan(described, [*micro_tables, f"data={corpus}", f"paths.runs={tmp_path}"])
        assert len({row.spec["key"] for row in rows}) == len(rows)
        render_table(described, rows, tmp_path / corpus, COMMAND)
        row = row_of((tmp_path / corpus / "table.csv").read_text(), "mdm")
        shown[corpus] = row["label"], float(row["fid_paper"])
    assert shown == {"synthetic": ("MDM-50Step", 0.518), "synthetic_kit": ("MDM", 0.585)}


def test_fewer_steps_than_a_model_was_trained_with_are_said(micro_tables):
    notes = {row.spec["key"]: tables._filled([row], {}, [])["note"] for row in plan(load_table("table5"), micro_tables)}
    assert "sampled in 16 of its 50 diffusion steps" in notes["mardm_ddpm"]
    assert "of its 1000 diffusion steps" in notes["motiondiffuse"]
    assert "diffusion steps" not in notes["mardm_sit"]


def test_a_deleted_line_blanks_its_row_and_no_other(gap, table, micro_tables, tmp_path):
    _, _, before = gap
    after = rendered(table, micro_tables, tmp_path / "after")
    row = row_of(after["table.csv"], "mardm_sit")
    assert row["replications"] == "0"
    assert not any(row[k] for k in ("r1", "fid", "matching", "clip_score"))
    assert "| MARDM-SiT | not yet run |" in after["table.md"]
    for line in csv.DictReader(before["table.csv"].splitlines()):
        if line["key"] != "mardm_sit":
            assert line == row_of(after["table.csv"], line["key"])


def test_only_the_missing_replication_is_run_again(gap, table, micro_tables, tmp_path):
    path, lines, before = gap
    (row,) = [row for row in plan(table, micro_tables) if row.cfg is not None and not row.complete]
    assert row.spec["key"] == "mardm_sit"
    assert missing_work(plan(table, micro_tables)) == [("evaluate", ["source=generation", "method=mardm_sit"])]
    others = {r.place.folder.path: r.place.folder.path.stat().st_mtime_ns for r in plan(table, micro_tables) if r.place}
    run_evaluation(row.cfg)
    again = path.read_text().splitlines(keepends=True)
    assert again[0] == lines[0]
    assert json.loads(again[1])["metrics"] == json.loads(lines[1])["metrics"]
    assert rendered(table, micro_tables, tmp_path / "after") == before
    for folder, changed in others.items():
        assert folder == path.parent or folder.stat().st_mtime_ns == changed


@pytest.mark.slow
def test_reproducing_runs_what_is_missing_and_renders(gap, table, micro_tables, tmp_path, capfd):
    path, _, before = gap
    reproduce.reproduce("table5", micro_tables, render_only=True, out=tmp_path / "blank")
    assert "no complete results for: MARDM-SiT" in capfd.readouterr().out
    reproduce.reproduce("table5", [*micro_tables, "launcher=local"], out=tmp_path / "whole")
    ours, theirs = (row_of(x, "mardm_sit") for x in ((tmp_path / "whole/table.csv").read_text(), before["table.csv"]))
    for metric in ("r1", "fid", "matching", "multimodality", "clip_score"):
        assert float(ours[metric]) == pytest.approx(float(theirs[metric]), rel=1e-3)  # threads add up differently
    said = capfd.readouterr().out
    assert said.count("run       ") == 1
    assert "replication 1:" in said
    assert "replication 0:" not in said
    assert len(path.read_text().splitlines()) == 2


def test_several_tables_share_their_jobs_and_pages_take_no_options_of_tables(
    table, micro_tables, tmp_path, monkeypatch
):
    calls: list[list[Job]] = []
    made: list[Request] = []
    rows = {row["key"]: row for row in table["rows"]}
    small = {name: {**table, "rows": [rows["real"], rows[name]]} for name in ("mardm_sit", "mardm_ddpm")}
    monkeypatch.setattr(reproduce, "load_table", lambda name: dict(small[name.replace("-", "_")]))
    monkeypatch.setattr(reproduce, "run_jobs", lambda jobs, count: calls.append(jobs))
    for maker in ("_reproduce_table", "_reproduce_page"):
        monkeypatch.setattr(reproduce, maker, lambda request, failed=None: made.append(request))
    overrides, names = [*micro_tables, f"paths.runs={tmp_path}/runs"], ["mardm-sit", "mardm-ddpm"]
    with pytest.raises(ValueError, match="--out is the folder of one report"):
        reproduce.reproduce_all(names, overrides, out=tmp_path)
    reproduce.reproduce_all([*names, "noise"], overrides, seeds=2)
    (jobs,) = calls
    alone = [missing_jobs(plan(one, overrides, 2), overrides) for one in small.values()]
    assert {job.makes for job in jobs} == {job.makes for part in alone for job in part}
    assert len(jobs) == len({job.makes for job in jobs}) < sum(map(len, alone))
    assert [(one.name, one.seeds, one.render_only) for one in made] == [
        *((name, 2, True) for name in names),
        ("noise", 1, False),
    ]


@pytest.mark.slow
def test_what_failed_for_several_tables_is_not_tried_again_and_every_row_says_why(
    table, micro_tables, tmp_path, monkeypatch
):
    wrong = [*micro_tables, f"paths.runs={tmp_path}/runs", "evaluator.decomposition.train.lr=1e30"]
    small = {**table, "rows": [row for row in table["rows"] if row["key"] in ("real", "shuffled")]}
    runs: list[int] = []
    tried = reproduce.run_jobs
    monkeypatch.setattr(reproduce, "load_table", lambda name: dict(small))
    monkeypatch.setattr(reproduce, "run_jobs", lambda jobs, count: runs.append(len(jobs)) or tried(jobs, count))
    monkeypatch.setattr(reproduce, "run_missing", lambda *_: pytest.fail("it was run again"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match=r"`kinema train stage=\w+ .*` failed: .*diverged"):
        reproduce.reproduce_all(["table5", "table6"], wrong, jobs=1)
    assert len(runs) == 1
    for name in ("table5", "table6"):
        assert "Real motion with shuffled captions: failed: " in (tmp_path / f"reports/{name}/table.md").read_text()


@pytest.mark.slow
def test_a_job_that_fails_is_named_and_its_rows_say_why(table, micro_tables, tmp_path):
    wrong = [*micro_tables, f"paths.runs={tmp_path}/runs", "evaluator.decomposition.train.lr=1e30"]
    small = {**table, "rows": [row for row in table["rows"] if row["key"] in ("real", "shuffled")]}
    patch = pytest.MonkeyPatch()
    patch.setattr(reproduce, "load_table", lambda name: dict(small))
    with pytest.raises(OSError, match=r"`kinema train stage=\w+ .*` failed: .*diverged"):
        reproduce.reproduce("table5", wrong, jobs=1, out=tmp_path / "report")
    patch.undo()
    shown = (tmp_path / "report/table.md").read_text()
    assert "Real motion with shuffled captions: failed: " in shown
    assert "diverged" in shown


@pytest.mark.slow
def test_a_multirun_that_fails_leaves_out_what_waits_for_it(table, micro_tables, tmp_path, capfd):
    wrong = [*micro_tables, f"paths.runs={tmp_path}/runs", "evaluator.decomposition.train.lr=1e30"]
    rows = plan({**table, "rows": [row for row in table["rows"] if row["key"] in ("real", "shuffled")]}, wrong)
    with pytest.raises(JobsFailedError) as failure:
        run_multiruns(missing_jobs(rows), wrong)
    assert [job.overrides[0] for job in failure.value.failed] == ["stage=decomposition"]
    assert "diverged" in str(failure.value)
    assert [job.overrides[0] for job in failure.value.left_out] == ["stage=matching", "source=real", "source=shuffled"]
    assert any((tmp_path / "runs/contrastive").glob("*/weights.safetensors"))  # of the same step: it was made
    said = capfd.readouterr().out
    assert said.count("run       ") == 1


def missing_work(rows: list[TableRow]) -> list[tuple[str, list[str]]]:
    return [(command, choices) for command, step in steps(missing_jobs(rows)) for choices in sweeps(step)]


def test_nothing_is_left_to_run_when_all_is_there(complete, table, micro_tables):
    assert missing_work(plan(table, micro_tables)) == []


def test_work_is_ordered_upstream_first(table, micro_tables, tmp_path):
    work = missing_work(plan(table, [*micro_tables, f"paths.runs={tmp_path}"]))
    assert [" ".join([command, choices[0]]) for command, choices in work] == [
        "train stage=tokenizer",
        "train stage=decomposition,contrastive",
        "train stage=length",
        "train stage=residual",
        "train stage=retrieval",
        "train stage=matching",
        "train stage=generator",
        "evaluate source=real,shuffled",
        "evaluate source=noise,nearest,reconstruction",
        "evaluate source=generation",
    ]


def test_what_motion_costs_is_told_where_a_table_asks(complete, table, micro_tables, tmp_path):
    asked = ("generator_parameters_m", "tokenizer_parameters_m", "generator_trained_k", "tokenizer_trained_k")
    columns = [{"key": key, "digits": 6} for key in (*asked, "seconds_per_motion")]
    described = {**table, "beside": columns}
    shown = json.loads(rendered(described, micro_tables, tmp_path)["table.json"])
    results = {row["key"]: row["results"] for row in shown["rows"]}
    (place,) = [row.place for row in plan(table, micro_tables) if row.spec["key"] == "mardm_sit"]
    generator = json.loads((place.subject["generator"] / "status.json").read_text())
    for told, line in zip(results["mardm_sit"], place.lines, strict=True):
        assert told["generator_parameters_m"] == generator["parameters"] / 1e6
        assert told["generator_trained_k"] == 24 * 32 / 1e3  # steps and batch of the micro scale
        assert told["tokenizer_trained_k"] > 0
        assert told["seconds_per_motion"] == line["seconds_per_motion"] > 0
        assert line["metrics"].keys() <= told.keys()
    assert "generator_parameters_m" not in results["ae"][0]
    assert not {*results["real"][0]} & {*asked, "seconds_per_motion"}
    plain = json.loads(rendered(table, micro_tables, tmp_path / "plain")["table.json"])
    assert not any(asked[0] in line for row in plain["rows"] for line in row["results"] or ())


def test_an_oracle_stands_where_the_corpus_has_labels(micro_tables, tmp_path):
    def oracles(overrides):
        rows = plan({"rows": [row for row in load_table("frontier")["rows"] if "oracle" in row["key"]]}, overrides)
        return [row.place.folder.path.name.split("-")[0] for row in rows]

    assert oracles(micro_tables) == ["oracle_action", "oracle_style"]
    folder = write_joints_folder(synthetic_clips(size=40, seed=2), tmp_path / "corpus")
    (folder / "manifest.json").unlink()
    others = [o for o in micro_tables if not o.startswith(("data", "paths.stores"))]
    others += ["data=open_mocap", f"data.source={folder}", f"paths.stores={tmp_path}"]
    assert oracles(others) == []
    with pytest.raises(ValueError, match=r"doesn't say which actions its clips show.*leave out what reads it"):
        run_evaluation(
            compose([*others, "scale.protocol.pool=4", "source=oracle", f"paths.runs={tmp_path}"], "evaluate")
        )


def test_a_given_run_has_no_further_seeds(micro_tables, table, tmp_path):
    rows = [row for row in table["rows"] if row["key"] == "mardm_sit"]
    given = {**table, "rows": [{**rows[0], "overrides": [f"run={tmp_path}/generator/imported"]}]}
    assert [row.seed for row in plan({**table, "rows": rows}, micro_tables, 3)] == [None, 1, 2]
    assert [row.seed for row in plan(given, micro_tables, 3)] == [None]


def test_a_row_borrows_metrics_replication_by_replication():
    """MARDM Table 1 has reconstruction and generation in one row."""
    borrow = {"row": "recon", "metrics": {"recon_fid": "fid", "dead": "dead_codes"}}
    rows = [
        TableRow({"key": "recon", "shown": False}, None, None),
        TableRow({"key": "made", "borrow": borrow}, None, None),
    ]
    lent, own = [{"fid": 1.0}, {"fid": 2.0, "dead_codes": 3.0}], [{"fid": 5.0}, {"fid": 6.0}]
    found = with_borrowed(rows, {"recon": lent, "made": own})
    assert found["made"] == [{"fid": 5.0, "recon_fid": 1.0}, {"fid": 6.0, "recon_fid": 2.0, "dead": 3.0}]
    assert with_borrowed(rows, {"recon": [], "made": own})["made"] == own  # its cells stay empty
    assert with_borrowed(rows, {"recon": lent, "made": []})["made"] == []
    with pytest.raises(ValueError, match="'made' borrows from 'recon', which is no row"):
        with_borrowed(rows[1:], {"made": own})


def test_one_method_under_two_judges(micro_tables, tmp_path):
    """MARDM Table 4: what rows don't share is said row by row; an essential-only method is lifted, and says so."""
    described = load_table("table4")
    described["rows"] = [row for row in described["rows"] if row["key"] in ("real", "real_lifted", "mardm_sit_all")]
    described.pop("effects")
    rows = plan(described, [*micro_tables, "scale.protocol.replications=1"])
    for row in rows:
        run_evaluation(row.cfg)
    lifted, mardm, real = plan(described, [*micro_tables, "scale.protocol.replications=1"])
    facts = provenance([lifted.said, mardm.said, real.said], COMMAND)
    both = "Real motion lifted, all dims; MARDM-SiT lifted, all dims"
    assert set(facts["evaluators"]) == {both, "Real motion, essential dims"}
    assert facts["statistics"][both]["evaluator"]["kind"] == "redundant"
    assert facts["corpus"]["name"] == real.cfg.data.name
    assert lifted.lines[0]["metrics"]["fid"] > 0  # against real motion that is not lifted
    assert mardm.lines[0]["metrics"]["n"] == real.lines[0]["metrics"]["n"]
    render_table(described, [lifted, mardm, real], tmp_path, COMMAND)
    assert "redundant dims recomputed from the joints" in (tmp_path / "table.md").read_text()


def test_a_table_of_two_judges_of_one_name_says_so(complete, table, micro_tables, tmp_path):
    rows = plan(table, micro_tables)
    first = next(row for row in rows if row.complete)
    file = first.place.folder.path / "replications.jsonl"
    before = file.read_text()
    weights = first.lines[0]["provenance"]["evaluators"]["matching"]
    file.write_text(before.replace(weights, "0123456789ab"))
    try:
        assert "scored by evaluators of different weights" in rendered(table, micro_tables, tmp_path)["table.md"]
    finally:
        file.write_text(before)
    assert "different weights" not in rendered(table, micro_tables, tmp_path)["table.md"]


TABLES = sorted(file.stem for file in (CONF / "table").glob("*.yaml"))


@pytest.mark.parametrize("name", [name for name in TABLES if meant_for(load_table(name), ["data=synthetic"])])
def test_the_work_makes_every_row_where_the_table_looks_for_it(name, micro_tables, tmp_path):
    described = load_table(name)
    overrides = [*(o for o in micro_tables if not o.startswith("generator.model")), f"paths.runs={tmp_path}"]
    rows = plan(described, overrides)
    made = set()
    for script, choices in missing_work(rows):
        if script == "evaluate":
            swept = [[f"{k}={v}" for v in values.split(",")] for k, values in (c.split("=", 1) for c in choices)]
            for combination in product(*swept):
                chosen = [*overrides, *described.get("overrides", []), *combination]
                made.add(evaluation.describe(compose(chosen, "evaluate")).folder.path)
    assert made == {row.place.folder.path for row in rows if row.place}


def test_a_table_on_a_split_of_its_own_keeps_the_judges_of_the_corpus(
    micro_tables, table, tmp_path, monkeypatch, capfd
):
    folder = write_joints_folder(synthetic_clips(size=40, seed=2), tmp_path / "corpus")
    lists = {part: (folder / f"{part}.txt").read_text() for part in ("train", "val", "test")}
    described = load_table("table5-compositional")
    assert described["rows"] == table["rows"]
    assert described["paper"] == table["paper"]
    assert described["title"] != table["title"]
    overrides = [o for o in micro_tables if not o.startswith(("data", "paths.stores"))]
    overrides += ["data=open_mocap", f"data.source={folder}", f"paths.stores={tmp_path}", f"paths.runs={tmp_path}"]
    with pytest.raises(FileNotFoundError, match=r"lacks compositional/train.txt, compositional/val.txt"):
        plan(described, overrides)
    (folder / "compositional").mkdir()
    for part, other in (("train", "train"), ("val", "test"), ("test", "val")):
        (folder / "compositional" / f"{part}.txt").write_text(lists[other])
    own, new = plan(table, overrides), plan(described, overrides)
    assert [row.place.judges for row in own if row.place] == [row.place.judges for row in new if row.place]
    assert not {row.place.folder.path for row in own if row.place} & {row.place.folder.path for row in new if row.place}
    monkeypatch.chdir(tmp_path)
    reproduce.reproduce("table5-compositional", ["data=synthetic"])
    assert "skipped   table5-compositional is a table of data=open_mocap alone" in capfd.readouterr().out
    assert not (tmp_path / "reports").exists()


def test_a_text_encoder_that_is_not_there_is_told_before_anything_trains(micro_tables, tmp_path, monkeypatch, capfd):
    small = load_table("table5")
    small["rows"] = [row for row in small["rows"] if row["key"] in ("ae", "mardm_sit")]
    monkeypatch.setattr(reproduce, "load_table", lambda name: dict(small))
    monkeypatch.setattr(reproduce, "run_missing", None)
    monkeypatch.chdir(tmp_path)
    words = ["table5", *micro_tables, f"paths.runs={tmp_path}/runs", "text=clip_b32", "text.path=/nowhere"]
    with pytest.raises(SystemExit) as stopped:
        reproduce.main(words)
    assert stopped.value.code == 2
    assert "/nowhere" in capfd.readouterr().err
    reproduce.main([*words, "--plan"])
    told = capfd.readouterr().out
    assert "lacking   " in told
    assert "/nowhere" in told
    assert "would run" in told
    assert not (tmp_path / "reports").exists()


def test_an_unknown_table_is_named_with_those_there_are(monkeypatch, capsys):
    with pytest.raises(FileNotFoundError, match=r"no table 'table55'; tables: .*table5"):
        load_table("table55")
    monkeypatch.setattr(table_files, "CONF", Path("none"))
    with pytest.raises(SystemExit) as stopped:
        reproduce.main(["table5"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("error: there is no table 'table5'")
    for words, told in (
        (["Table5"], "no table 'Table5'"),
        (["data=synthetic"], "no table 'data=synthetic'"),
        (["noise", "TableX", "data=synthetic"], "no table 'TableX'"),
    ):
        with pytest.raises(SystemExit):
            reproduce.main(words)
        assert told in capsys.readouterr().err


def test_the_runs_behind_a_table_are_told_without_a_path_of_this_machine(complete, table, micro_tables, tmp_path):
    told = json.loads(rendered(table, micro_tables, tmp_path)["table.json"])
    runs = {run["name"]: run for run in told["runs"]}
    (row,) = [row for row in plan(table, micro_tables) if row.spec["key"] == "mardm_sit"]
    for stage, path in row.place.runs.items():
        run = runs[path.name]
        assert run["stage"] == stage
        assert row.spec["label"] in run["rows"]
        assert run["facts"]["parameters"] > 0
        assert run["curves"], stage
    generator = runs[row.place.runs["generator"].name]
    assert "MARDM" in generator["config"]["generator"]["model"]["_target_"]
    assert generator["facts"]["from tokenizer"] in runs
    assert str(tmp_path.parent) not in json.dumps(told["runs"])
    assert set(told["motions"]) >= {"real", "mardm_sit", "shuffled"}
