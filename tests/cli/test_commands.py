"""The other commands, help and errors: prepare and doctor, one line and exit code 2 for what is wrong."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from tests.cli.conftest import fails

from kinema import __version__, cli, interop
from kinema.cli import parser
from kinema.motion import body_parts
from kinema.runs.folder import RunFolder


def test_prepare_gives_a_store_that_opens(tmp_path, capsys):
    from kinema.data.store import PackedStore

    out = str(tmp_path / "store")
    for _ in range(2):
        assert cli.main(["prepare", "--format", "synthetic", "--out", out, "--set", "size=12", "--processes", "1"]) == 0
    store = PackedStore.open(out)
    assert store.num_clips == 24
    assert store.name == "synthetic"


def test_doctor_examines_what_prepare_wrote(tmp_path, capsys):
    out = str(tmp_path / "store")
    assert cli.main(["prepare", "--format", "synthetic", "--out", out, "--set", "size=12", "--processes", "1"]) == 0
    assert cli.main(["doctor", out]) == 0
    assert "doctor: " in capsys.readouterr().out
    fails(capsys, ["doctor", str(tmp_path / "nowhere")], "nowhere")


def test_doctor_examines_the_corpus_that_overrides_name(tmp_path, capsys):
    words = ["data=synthetic", "data.options.size=12", f"paths.stores={tmp_path}"]
    assert cli.main(["doctor", *words]) == 0
    assert "doctor: " in capsys.readouterr().out
    fails(capsys, ["doctor", str(tmp_path), "data=synthetic"], "doctor takes one path, or KEY=VALUE overrides")


def test_hydra_reads_the_words_behind_the_command_and_lightning_all(tmp_path, monkeypatch):
    """Processes of further devices are started with what sys.argv was, so the job has to see it whole."""
    seen = []

    def run_stage(cfg, stage):
        seen.append((stage, cfg.seed, sys.argv))
        return RunFolder(tmp_path)

    monkeypatch.setattr("kinema.experiments.run.run_stage", run_stage)
    words = ["kinema", "train", "stage=tokenizer", "seed=3"]
    monkeypatch.setattr(sys, "argv", words)
    assert cli.main() == 0
    assert seen == [("tokenizer", 3, words)]
    assert sys.argv == words


def test_info_without_a_run_says_what_a_bug_report_needs(capsys):
    assert cli.main(["info"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kinema"] == __version__
    assert {"python", "torch", "system"} <= set(said)


def test_figures_are_named(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["figures", "table5"])
    assert capsys.readouterr().err == "error: no figure table5; choose one of bad_masks, code_usage\n"
    with pytest.raises(SystemExit):
        cli.main(["figures", "code_usage", "--help"])
    assert "usage: kinema figures code_usage" in capsys.readouterr().out


def test_errors_are_one_line_and_exit_with_2(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--out", "a.npz"]
    fails(capsys, make, "no length: give frames= or seconds=")
    fails(capsys, [*make, "--frames", "500"], "length 500 is out of range; allowed: 1 to 196")
    fails(capsys, [*make, "--frames", "8", "--set", "step=2"], "unknown sampling field 'step'; allowed: steps")
    fails(capsys, [*make, "--frames", "8", "--set", "steps"], "--set steps is no KEY=VALUE")
    fails(capsys, [*make[:-1], "a.gif", "--frames", "8"], "unknown suffix '.gif', choose one of .html")
    fails(capsys, ["generate", " ", "--run", str(run), "--out", "a.npz", "--frames", "8"], "text 0 is empty")
    fails(capsys, ["generate", "x", "--run", "runs/none", "--out", "a.npz"], "no run folder at runs/none")
    fails(capsys, ["generate", "x", "--run", "runs/ae", "--out", "a.npz"], "give the folder of a 'generator' run")
    fails(
        capsys,
        ["generate", "x", "--run", str(run), "--out", "a.npz", "--device", "nothing:0"],
        "device 'nothing:0' cannot be used here",
    )
    change = ["edit", "--motion", "none.npz", "--text", "x", "--run", str(run), "--out", "a.npz", "--regenerate"]
    fails(capsys, [*change, "0:4"], "none.npz is missing")
    fails(capsys, ["import", "mardm-ae", "none.tar", "--out", "runs/b"], "no checkpoint file at none.tar")
    fails(capsys, ["import", "mardm", "mardm.tar", "--out", "runs/b"], "mardm needs --tokenizer RUN")
    again = ["import", "mardm", "mardm.tar", "--out", "runs/b", "--tokenizer", "runs/ae"]
    fails(capsys, again, "'mardm' needs the option 'variant'")
    fails(capsys, ["import", "mardm-ae", "ae.tar", "--out", "runs/ae"], "runs/ae exists; choose another folder")
    fails(capsys, ["prepare", "--format", "joints", "--out", "store"], "--format joints needs SOURCE")
    fails(capsys, ["prepare", "none", "--format", "joints", "--out", "store"], "corpus folder none does not exist")
    fails(capsys, ["info", "runs/none"], "no weights at")
    assert not (run.parent / "b").exists()
    with pytest.raises(ValueError, match="no length"):
        cli.main([*make, "--debug"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--set guidance=2,5", "sampling.guidance=[2, 5]: must be a finite number >= 0"),
        ("--set guidance=high", "sampling.guidance=high: must be a finite number >= 0"),
        ("--set guidance=", 'sampling.guidance="": must be a finite number >= 0'),
        ("--set guidance=nan", "sampling.guidance=nan: must be a finite number >= 0"),
        ("--set guidance=1e999", "sampling.guidance=Infinity: must be a finite number >= 0"),
        ("--set guidance=null", "sampling.guidance=null: must be a finite number >= 0"),
        ("--set guidance=true", "sampling.guidance=true: must be a finite number >= 0"),
        ("--set steps=2.5", "sampling.steps=2.5: must be a whole number from 1"),
        ("--set steps=1e3", "sampling.steps=1000.0: must be a whole number from 1"),
        ("--set steps=many", "sampling.steps=many: must be a whole number from 1"),
        ("--set solver=fast", "sampling.solver=fast: must be one of ancestral, "),
        ("--set solver_steps=x", "sampling.solver_steps=x: must be a whole number from 1 to 100000 or counts such as"),
        ("--set clip_latents=maybe", "sampling.clip_latents=maybe: must be true or false"),
        ("--set frames=3", "unknown sampling field 'frames'; allowed: steps"),
        ("--set seed=3", "unknown sampling field 'seed'; allowed: steps"),
        ("--seed -1", "seed=-1: must be a whole number >= 0"),
        ("--seed 9223372036854775808", "seed=9223372036854775808: must be a whole number >= 0"),
    ],
)
def test_a_wrong_option_of_sampling_is_one_line(run, capsys, words, message):
    fails(capsys, ["generate", "x", "--run", str(run), "--out", "a.npz", "--frames", "8", *words.split()], message)


def test_a_wrong_length_or_number_of_processes_is_one_line(run, capsys):
    make = ["generate", "x", "--run", str(run), "--out", "a.npz"]
    for seconds, shown in (("inf", "Infinity"), ("nan", "NaN"), ("-inf", "-Infinity")):
        fails(capsys, [*make, f"--seconds={seconds}"], f"seconds={shown}: must be a finite number")
    change = ["edit", "--motion", "none.npz", "--text", "x", "--run", str(run), "--out", "a.npz", "--set", "motions=3"]
    fails(capsys, [*change, "--regenerate", "0:4"], "unknown sampling field 'motions'; allowed: steps")
    make = ["prepare", "--format", "synthetic", "--out", "store"]
    for processes in (-1, 0, 10**6):
        fails(capsys, [*make, "--processes", str(processes)], f"--processes={processes}: must be a whole number from 1")
    for given, message in (("size=many", "--set.size=many: must be a whole"), ("sizes=3", "--set.sizes is no option")):
        fails(capsys, [*make, "--set", given], message)


def test_an_autoencoder_without_statistics_says_so(run, capsys):
    assert cli.main(["import", "mardm-ae", "ae.tar", "--out", "runs/bare"]) == 0
    assert "import it with --statistics PATH" in capsys.readouterr().out


def test_help_needs_no_torch():
    code = "import sys; from kinema import cli\ntry: cli.main(['generate', '--help'])\nexcept SystemExit: pass\n"
    code += "assert not {'torch', 'numpy', 'lightning'} & sys.modules.keys()"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_the_choices_are_those_that_exist():
    assert set(parser.KINDS) == set(interop.KINDS)
    assert parser.PARTS == body_parts.PARTS


def test_values_that_begin_with_a_dash_are_values():
    assert cli._joined(["edit", "--hold", "-1,0", "--up", "-z", "--out", "x"]) == [
        "edit",
        "--hold=-1,0",
        "--up=-z",
        "--out",
        "x",
    ]
    assert cli._joined(["edit", "--hold", "--out"]) == ["edit", "--hold", "--out"]
