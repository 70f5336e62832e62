"""One short run of each study, by the command that its README names."""

import re
import runpy
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym.benchmark.runner import benchmark
from studies.body_model.known_body import KnownBody

pytestmark = pytest.mark.slow

STUDIES = Path(__file__).parents[2] / "studies"
FEW = "--episodes 3 --scenarios random longer-20"

# A short run of each: its arguments, and what it prints.
SHORT = {
    "body_model.parts": (f"{FEW} --tables parts switches vigour", r"longer-20 .* 100\.0"),
    "body_model.constants": (
        "--episodes 3 --scenarios delay-400 --only LONGEST_DELAY FORGET",
        r"(?s)body\.FORGET .* senses\.LONGEST_DELAY .* -66\.67 .* delay-400",
    ),
    "body_model.failures": (FEW, r"failures of mmc-body"),
    "body_model.standings": ("--stores store", r"tasks, unperturbed \(1\)"),
    "body_model.hidden_scenarios": ("--episodes 2 --only delay-60", r"delay-60 .* 100\.0"),
    "body_model.pairs": ("--pairs 2 --episodes 3", r"(?s)success %, 3 episodes.* all 2 .* \d"),
    "learners.plain_learners": (
        "--learners ppo --seeds 0 --steps 2048 --at 2048 --jobs 1 --out out",
        r"(?s)PPO .* \[0\.\d+",
    ),
    "learners.learning_speed": (
        "--seeds 1 --arms 64 --steps 1024 --targets 20 --no-profile",
        r"median .* 95%",
    ),
    "learners.train_all": ("--names ppo --seeds 1 --steps 4096 --jobs 1", r"ppo-0 +success"),
    "learners.gain_at_target": ("--agents mmc ppo-0", r"mmc .* 2\.2 / s, 0\.02"),
    "network.abilities": ("--segments 2 3 --arms 50 --iterations 100", r"inverse .*100%"),
    "network.normalization_training": ("--epochs 1 --widest 4", r"\[4, 4\]"),
    "other_bodies.trainings": ("sac --at 101 --out .", r"101 steps"),
    "other_bodies.reacher": (
        "--episodes 3 --agents mmc-body optimum --out .",
        r"as given .* 100\.0, -[2-4]\.\d\d .* 100\.0, -[2-4]\.",
    ),
    "other_bodies.panda": (
        "--episodes 3 --bodies given --agents mmc-body pybullet",
        r"given .* 100\.0 .* 100\.0, -[1-4]\.\d\d .* 100\.0, -[3-9]\.",
    ),
    "adaptation.recovery": ("--groups 2 --subjects 4", r"A_s .* 0\.99"),
    "adaptation.clamps": ("--counts 8 --trials 16 --subjects 1", r"8 .* 15\.8"),
    "adaptation.reward": (
        "--sac-steps 150 --ppo-steps 2048 --trials 2 --every 1 --out out/curves.json",
        r"trials .* SAC .* PPO",
    ),
    "people": (
        "--agents ik-dls --subjects 2 --episodes 8 --out out",
        r"rotation-30 .* after-effect",
    ),
    "body.physics": ("--agents mmc --episodes 5 --steps 40", r"(?s)mmc .* 100\.0.*analytic"),
}


@pytest.mark.parametrize("study", SHORT)
def test_a_study_runs_and_prints_its_table(study, tmp_path, monkeypatch, capsys):
    if study.startswith("other_bodies.panda"):
        pytest.importorskip("panda_gym")
    monkeypatch.chdir(tmp_path)
    if study == "body_model.standings":
        benchmark(["mmc-body", "ik-dls", "ppo-0"], "store", ["random"], 3, jobs=1)
    arguments, shown = SHORT[study]
    monkeypatch.setattr(sys, "argv", [study, *arguments.split()])
    monkeypatch.setenv("COLUMNS", "160")  # tables are printed whole
    monkeypatch.delitem(sys.modules, f"studies.{study}", raising=False)  # as other tests import it
    runpy.run_module(f"studies.{study}", run_name="__main__", alter_sys=True)
    assert re.search(shown, capsys.readouterr().out)


def test_the_readme_names_every_study_that_is_there():
    readme = (STUDIES / "README.md").read_text("utf-8")
    commands = {
        ".".join(path.relative_to(STUDIES).with_suffix("").parts)
        for path in STUDIES.rglob("*.py")
        if 'if __name__ == "__main__"' in path.read_text("utf-8")
    }
    named = set(re.findall(r"python -m studies\.([\w.]+)", readme))
    assert {name.removesuffix(".__main__") for name in commands} == named


def test_an_agent_that_is_given_its_body_acts_however_late_its_senses_are():
    envs = gym.make_vec("MMCReach-v0", num_envs=2, perturbations=["delay-600", "locks-1"])
    (observations, _), state, agent = envs.reset(seed=0), None, KnownBody(envs)
    for _ in range(50):
        actions, state = agent.predict(observations, state)
        observations, *_ = envs.step(actions)
    assert np.abs(actions).max() > 0
