"""Facts about agents in experiments: what is recorded, kept from trial to trial, and resumed."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.agents.base import Agent
from mmc_gym.benchmark import trials
from mmc_gym.benchmark.experiment import Block, Experiment, Probe
from mmc_gym.benchmark.trials import ExperimentResult, read_experiments, run_experiment
from mmc_gym.interface import ReachInterface

SHORT = Experiment(
    "short",
    (
        Block("baseline", 2, targets=(0.0, 90.0)),
        Block("learning", 3, ("rotation-30",), (0.0,), (Probe("catch", 3),), rest=5.0),
        Block("clamp", 1, ("clamp-15",), (180.0,), go_cue=0.1),
    ),
    trial_seconds=0.3,
    noise=("joint-noise-0.01",),
)


class Counter(Agent):
    """Turns its first joint the faster the more trials, and seconds of rest, there were."""

    def __init__(self, env):
        self.layout = ReachInterface.of(env).layout

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.zeros(len(observation)) if state is None else state
        action = np.zeros((len(observation), 3), np.float32)
        action[:, 0] = 0.1 * state
        return action, state

    def between_trials(self, state, rest=0.0):
        return state + 1 + rest


def still(env):
    action = np.zeros(3, np.float32)
    return SimpleNamespace(predict=lambda *_, **__: (action, None))


def are_equal(one: ExperimentResult, other: ExperimentResult) -> bool:
    paths = ("hands", "cursors", "targets")
    same = [np.array_equal(getattr(one, name), getattr(other, name)) for name in paths]
    return all(same) and one.trials.equals(other.trials)


def test_a_row_says_what_happened_in_a_trial() -> None:
    result = run_experiment(SHORT, ["mmc-body"], subjects=2, jobs=1)
    table, hands, cursors = result.trials, result.hands, result.cursors
    assert hands.shape == (12, 21, 2)
    assert list(table["subject"]) == [0] * 6 + [1] * 6
    assert list(table["phase"][:6]) == ["baseline"] * 2 + ["learning"] * 3 + ["clamp"]
    assert (hands[:, 0] == table[["start_x", "start_y"]]).all(axis=None)
    assert np.ptp(hands[:, 0], axis=0) == pytest.approx([0, 0])
    is_turned = (table["perturbation"] == "rotation-30").to_numpy()
    assert is_turned.sum() == 4
    assert (table["probe"] == "catch").sum() == 2
    turns = [np.degrees(np.angle((of - of[:, :1])[:, -1] @ (1, 1j))) for of in (hands, cursors)]
    assert (turns[1] - turns[0])[is_turned] == pytest.approx(30, abs=1e-3)
    assert (hands == cursors)[table["phase"] == "baseline"].all()
    assert np.abs(turns[1][table["phase"] == "clamp"]) == pytest.approx(165, abs=1e-3)
    assert list(table["go_step"]) == [0, 0, 0, 0, 0, 5] * 2
    assert result.targets[5, :5] == pytest.approx(hands[5, :1].repeat(5, axis=0), abs=1e-6)


def test_subjects_are_the_same_however_many_there_are() -> None:
    few = run_experiment(SHORT, ["mmc-body", "ppo"], subjects=2, jobs=1)
    many = run_experiment(SHORT, ["mmc-body", "ppo"], subjects=3, jobs=1)
    chosen = (many.trials["subject"] < 2).to_numpy()
    assert np.array_equal(few.hands, many.hands[chosen])
    assert not np.array_equal(many.hands[6:12], many.hands[12:18])


def test_what_an_agent_keeps_is_handed_to_its_next_trial() -> None:
    result = run_experiment(SHORT, {"counter": Counter}, subjects=1, jobs=1)
    ways = np.linalg.norm(np.diff(result.hands, axis=1), axis=-1)[:, 10]
    assert ways[0] < 1e-6
    assert (np.argsort(ways) == range(6)).all()
    assert ways[2] > 4 * ways[1]  # after a rest


def test_an_agent_that_keeps_nothing_plays_all_trials_at_once_as_one_by_one(monkeypatch) -> None:
    at_once = run_experiment(SHORT, ["mmc-body"], subjects=2, jobs=1)
    monkeypatch.setattr(trials, "_TOGETHER", 1)
    assert are_equal(at_once, run_experiment(SHORT, ["mmc-body"], subjects=2, jobs=1))


def test_a_memory_can_be_kept_whole() -> None:
    agents = {"forgets": "ppo-memory", "keeps": "ppo-memory"}
    result = run_experiment(SHORT, agents, subjects=1, keep=["keeps"], jobs=1)
    assert np.array_equal(result.hands[0], result.hands[6])
    assert not np.array_equal(result.hands[1], result.hands[7])
    with pytest.raises(UserError, match="keep 'ppo'"):
        run_experiment(SHORT, ["mmc"], keep=["ppo"])


def test_your_own_object_with_predict_is_played_a_subject_at_a_time() -> None:
    result = run_experiment(SHORT, {"still": still}, subjects=2, jobs=1)
    assert np.ptp(result.hands, axis=(0, 1)) == pytest.approx([0, 0], abs=1e-6)


def test_a_run_resumes_and_a_damaged_cell_is_played_again(tmp_path: Path, monkeypatch) -> None:
    whole = run_experiment(SHORT, ["mmc", "ik-dls"], subjects=2, jobs=1)
    run_experiment(SHORT, ["mmc"], subjects=2, out=tmp_path, jobs=1)
    played = []
    run_cell = trials.run_cell
    monkeypatch.setattr(trials, "run_cell", lambda cell: played.append(cell) or run_cell(cell))
    resumed = run_experiment(SHORT, ["mmc", "ik-dls"], subjects=2, out=tmp_path, jobs=1)
    assert [cell.agent.label for cell in played] == ["ik-dls"]
    assert are_equal(whole, resumed)
    next(tmp_path.glob("trials/mmc*")).write_bytes(b"PAR1")
    run_experiment(SHORT, ["mmc"], subjects=2, out=tmp_path, jobs=1)
    assert [cell.agent.label for cell in played] == ["ik-dls", "mmc"]
    (stored,) = read_experiments(tmp_path)
    assert stored.experiment == SHORT
    assert set(stored.trials["agent"]) == {"mmc", "ik-dls"}


def test_a_trial_that_ends_before_its_jump_shows_no_correction() -> None:
    jumps = (Probe("jump left", 2, target_jump=10.0),)
    for seconds, seen in ((0.06, False), (0.6, True)):
        block = Block("jumps", 4, targets=(0.0,), probes=jumps)
        short = Experiment("jumps", (block,), trial_seconds=seconds)
        measures = run_experiment(short, ["ik-dls"], subjects=1, jobs=1).measures["measure"]
        assert ({"latency", "gain"} <= set(measures)) == seen
