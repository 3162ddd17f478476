"""The page of solvers: every point is a cached evaluation on val, its network rows are those that the formulas say."""

from __future__ import annotations

import csv
import warnings

import pytest
import torch

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.evaluation.counting import NetworkCounter
from kinema.experiments import pages
from kinema.experiments.config import CONF, compose
from kinema.experiments.evaluation import describe
from kinema.experiments.pages import load_page
from kinema.experiments.pages.solvers import mark_fast, points
from kinema.experiments.reproduce import reproduce
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import plan
from kinema.generators.mar import MARDM, MarSampling
from kinema.generators.mdm import MDM, FrameSampling
from kinema.types import TextFeatures

pytestmark = pytest.mark.usefixtures("unchecked")

FRAMES = torch.tensor([16, 9, 12])
EVALUATIONS = {"ancestral": 1, "ddim": 1, "dpmpp_2m": 1, "euler": 1, "midpoint": 2, "heun": 2, "rk4": 4}
"""Of a step; DDPM's heun takes its last step with one."""


def text(size):
    return TextFeatures(["a"] * size, torch.randn(size, 8, generator=torch.Generator().manual_seed(0)))


def counted(generator, sampling):
    counter = NetworkCounter(generator.networks)
    generator.eval().sample(text(len(FRAMES)), FRAMES, seeds=torch.arange(len(FRAMES)), sampling=sampling)
    return counter.take(batches=1, motions=1)


def evaluations(process, solver, steps):
    count = EVALUATIONS[solver] * steps
    return count - 1 if isinstance(process, DDPM) and solver == "heun" else count


@pytest.mark.parametrize("solver", ["ancestral", "ddim", "heun", "dpmpp_2m"])
@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_rows_of_a_method_on_frames_are_steps_times_passes_times_motions(solver, guidance):
    process = DDPM(20, prediction="x0")
    mdm = MDM(frame_dim=5, text_dim=8, process=process, width=16, feedforward=16, layers=1, heads=2)
    found = counted(mdm, FrameSampling(guidance=guidance, solver=solver, solver_steps=6))
    calls, passes = evaluations(process, solver, 6), 1 if guidance == 1 else 2
    assert found == {"denoiser_calls": calls, "denoiser_rows": calls * passes * len(FRAMES)}


@pytest.mark.parametrize(
    ("process", "solver"),
    [(DDPM(20), "ancestral"), (DDPM(20), "heun"), (Flow(), "euler"), (Flow(), "midpoint"), (Flow(), "rk4")],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
@pytest.mark.parametrize("guidance", [1.0, 1.5])
def test_rows_of_mardm_are_latents_once_each_times_the_solver(process, solver, guidance):
    """The last mask is decoded in as many steps as release a position, which differ between motions of a batch."""
    small = {"width": 16, "feedforward": 16, "heads": 2, "mlp_width": 8, "mlp_depth": 1}
    mar = MARDM(latent_dim=5, text_dim=8, process=process, **small)
    sampling = MarSampling(steps=3, guidance=guidance, solver=solver, solver_steps=4)
    found = counted(mar, sampling)
    passes, latents = 1 if guidance == 1 else 2, int((FRAMES // 4).sum())
    assert found["denoiser_rows"] == evaluations(process, solver, 4) * passes * latents
    released = found["transformer_calls"]
    assert 1 <= released <= 3
    assert found["transformer_rows"] == released * passes * len(FRAMES)
    assert found["denoiser_calls"] == released * evaluations(process, solver, 4)


def test_the_fast_point_is_the_cheapest_within_the_interval_of_the_best_of_whole_rows():
    points = [
        (100, 1.0, 0.2, 2),
        (40, 1.1, 0.0, 2),
        (20, 1.19, 0.5, 2),
        (10, 1.3, 0.5, 2),
        (None, 0.9, 0.0, 2),
        (5, 0.8, None, 1),
    ]
    rows = [{"rows": rows, "fid": fid, "fid ±": half, "n": n} for rows, fid, half, n in points]
    mark_fast(rows)
    assert [row.get("fast") for row in rows] == [None, None, "fast", None, None, None]


def test_every_point_is_scored_on_val_by_the_methods_own_run(micro_tables):
    page = load_page("solvers")
    common = [o for o in micro_tables if not o.startswith("generator.model.dropout")]  # which not every method has
    rows = plan({"rows": list(points(page)), "overrides": page["overrides"]}, common)
    assert {row.cfg.scale.protocol.split for row in rows} == {"val"}
    places = [row.place.folder.path for row in rows]
    assert len(set(places)) >= len(rows) - len(page["methods"])  # a default may be one of the other points
    for spec in page["methods"]:
        own = [row for row in rows if row.spec.get("method") == spec["method"]]
        assert len({row.place.subject["generator"] for row in own}) == 1
        assert {tuple(row.trained) for row in own} == {(f"method={spec['method']}",)}


def test_a_point_is_a_solver_on_a_grid_or_guidance_in_an_interval():
    spec = {"key": "a", "label": "A", "method": "msflow", "solvers": "some", "intervals": [[0.0, 0.9]]}
    solvers = {"some": {"heun emergence": [6], "dopri5": [None]}}
    found = {row["key"]: row.get("overrides") for row in points({"methods": [spec], "solvers": solvers})}
    at = "generator.sampling."
    assert found == {
        "real": None,
        "a-default": [],
        "a-heun-6-emergence": [f"{at}solver=heun", f"{at}solver_steps=6", f"++{at}solver_grid=emergence"],
        "a-dopri5": [f"{at}solver=dopri5", f"{at}solver_steps=null"],
        "a-default-guided-0-to-0.9": [f"++{at}guidance_interval=[0.0, 0.9]"],
    }


POINTS = ("default", "euler-3", "euler-2", "euler-1", "heun-1", "euler-3-emergence")


def test_points_are_scored_once_and_drawn(micro, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    small = load_page("solvers")
    small["methods"] = [spec for spec in small["methods"] if spec["key"] == "mardm_sit"]
    small["at"] = {}
    small["solvers"] = {"flow": {"euler": [3, 2, 1], "heun": [1], "euler emergence": [3]}}
    monkeypatch.setattr(pages, "load_page", lambda name: small)
    for _ in range(2):
        reproduce("solvers", micro, jobs=1, out=tmp_path / "page")
        told = capsys.readouterr().out
    assert "run " not in told
    rows = {row["key"]: row for row in csv.DictReader((tmp_path / "page/solvers.csv").open())}
    assert set(rows) == {"real", *(f"mardm_sit-{p}" for p in POINTS)}
    costs = {key: float(row["rows"]) for key, row in rows.items() if key != "real"}
    assert costs["mardm_sit-euler-2"] == pytest.approx(2 * costs["mardm_sit-euler-1"])
    assert costs["mardm_sit-euler-3-emergence"] == pytest.approx(costs["mardm_sit-euler-3"])
    assert rows["mardm_sit-euler-3-emergence"]["fid"] != rows["mardm_sit-euler-3"]["fid"]
    assert costs["mardm_sit-heun-1"] == pytest.approx(costs["mardm_sit-euler-2"])
    assert sum(row["fast"] == "fast" for row in rows.values()) == 1
    assert (tmp_path / "page/solvers.png").read_bytes().startswith(b"\x89PNG")
    assert "fast" in (tmp_path / "page/README.md").read_text()


FAST = sorted(file.stem for file in (CONF / "sampling" / "fast").glob("*.yaml"))


@pytest.mark.parametrize("method", FAST)
@pytest.mark.parametrize("scale", ["tiny", "paper"])
def test_the_fast_sampler_is_an_option_of_every_diffusion_method(method, scale):
    from kinema.experiments.stages import get_stage
    from kinema.runs.build import build

    own = ["text=hashed", f"method={method}", f"scale={scale}", "data=humanml3d"]
    published, fast = (compose([*own, *extra], "evaluate") for extra in ((), ("sampling=fast",)))
    with torch.device("meta"):
        model = build(get_stage("generator").spec(fast))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.check_sampling(model.sampling)
    assert model.sampling.solver == fast.generator.sampling.solver
    assert get_stage("generator").settings(published) == get_stage("generator").settings(fast)


def test_a_table_can_show_both(micro):
    table = {"rows": [row for row in load_table("table5")["rows"] if row.get("method") == "mardm_sit"][-1:]}
    table["rows"].append({**table["rows"][0], "key": "fast", "overrides": ["sampling=fast"]})
    published, fast = plan(table, micro)
    assert published.place.folder.path != fast.place.folder.path
    assert published.place.subject == fast.place.subject
    assert fast.trained == ["method=mardm_sit"]


def test_a_method_without_a_fast_sampler_says_so(micro):
    with pytest.raises(ValueError, match=r"no sampler for this method, only for mardm_ddpm, .*leave it out"):
        describe(compose([*micro, "method=bad_cbs", "sampling=fast"], "evaluate"))
