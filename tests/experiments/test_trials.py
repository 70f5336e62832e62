"""Facts about agents in experiments: what is recorded, kept from trial to trial, and resumed."""

import re
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from mmc_gym import TrialLearner, UserError, make_vec
from mmc_gym.experiments import trials
from mmc_gym.experiments.adaptation import learning_of
from mmc_gym.experiments.experiment import Block, Experiment, Probe
from mmc_gym.experiments.results import ExperimentResult
from mmc_gym.experiments.trials import read_experiments, run_experiment
from mmc_gym.geometry import node_positions, segments_from_joint_angles
from mmc_gym.interface import ReachInterface
from mmc_gym.report import write_report

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
GRADUAL = Experiment("x", (Block("a", 2), Block("b", 7, "delay-40", gradual=True)))


class Known(TrialLearner):
    def aim(self, target, state):
        return target - state

    def learn(self, error, state):
        return 0.9 * state + 0.3 * error

    def rest(self, seconds, state):
        return 0.5 * state


class Differs(Known):
    motor_noise, noise_spread = 0.1, 0.3

    def first(self, random):
        return random.normal(0.0, 20.0)


def are_equal(result: ExperimentResult, other: ExperimentResult) -> bool:
    paths = ("hands", "cursors", "targets")
    same = [np.array_equal(getattr(result, name), getattr(other, name)) for name in paths]
    return all(same) and result.trials.equals(other.trials)


def printed(result: ExperimentResult) -> str:
    console = Console(record=True, width=300)
    result.print(console)
    return console.export_text()


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
    agents = {name: name for name in ("mmc-body", "ppo", "random")}
    agents |= {"differ": "mmc-body", "noisy": "mmc-body", "own": Differs}
    differing = {"rate_spread": 0.3, "retention_spread": 0.01}
    learners = {"differ": differing, "noisy": {"planning_noise": 4.0, "noise_spread": 0.3}}
    few, many = (run_experiment(SHORT, agents, n, learners=learners, jobs=1) for n in (2, 3))
    is_in_both = (many.trials["subject"] < 2).to_numpy()
    assert np.array_equal(few.hands, many.hands[is_in_both])
    pd.testing.assert_frame_equal(few.trials, many.trials[is_in_both].reset_index(drop=True))
    for name in agents:
        hands = many.hands[(many.trials["agent"] == name).to_numpy()]
        assert not np.array_equal(hands[6:12], hands[12:18])


@pytest.mark.parametrize("is_whole", [True, False])
def test_any_object_plays_subject_by_subject_and_says_what_it_keeps_between_trials(is_whole):
    rests, action = [], np.zeros(3, np.float32)
    predict = (lambda *_, **__: (action, 7)) if is_whole else lambda observation: (action, 7)
    agent = SimpleNamespace(predict=predict, between_trials=lambda *call: rests.append(call))
    run_experiment(SHORT, {"own": lambda env: agent}, subjects=2, jobs=1)
    assert rests == [(7, 0.0), (7, 5.0), (7, 0.0), (7, 0.0), (7, 0.0)] * 2


def test_an_agent_that_keeps_nothing_plays_all_trials_at_once_as_one_by_one(monkeypatch) -> None:
    at_once = run_experiment(SHORT, ["ppo"], subjects=2, jobs=1)
    monkeypatch.setattr(trials, "_TOGETHER", 1)
    assert are_equal(at_once, run_experiment(SHORT, ["ppo"], subjects=2, jobs=1))


def test_a_memory_can_be_kept_whole() -> None:
    agents = {"forgets": "ppo-memory", "keeps": "ppo-memory"}
    result = run_experiment(SHORT, agents, subjects=1, keep=["keeps"], jobs=1)
    assert np.array_equal(result.hands[0], result.hands[6])
    assert not np.array_equal(result.hands[1], result.hands[7])


def test_a_run_resumes_and_a_damaged_cell_is_played_again(tmp_path: Path, monkeypatch) -> None:
    whole = run_experiment(SHORT, ["mmc", "ik-dls"], subjects=2, jobs=1)
    run_experiment(SHORT, ["mmc"], subjects=2, out=tmp_path, jobs=1)
    run_cells = []
    run_cell = trials.run_cell
    monkeypatch.setattr(trials, "run_cell", lambda cell: run_cells.append(cell) or run_cell(cell))
    resumed = run_experiment(SHORT, ["mmc", "ik-dls"], subjects=2, out=tmp_path, jobs=1)
    assert [cell.agent.label for cell in run_cells] == ["ik-dls"]
    assert are_equal(whole, resumed)
    next(tmp_path.glob("trials/mmc*.parquet")).write_bytes(b"PAR1")
    run_experiment(SHORT, ["mmc"], subjects=2, out=tmp_path, jobs=1)
    assert [cell.agent.label for cell in run_cells] == ["ik-dls", "mmc"]
    (stored,) = read_experiments(tmp_path)
    assert stored.experiment == SHORT
    assert set(stored.trials["agent"]) == {"mmc", "ik-dls"}


@pytest.mark.parametrize(("seconds", "seen"), [(0.06, False), (0.6, True)])
def test_a_trial_that_ends_before_its_jump_shows_no_correction(seconds, seen) -> None:
    block = Block("jumps", 4, targets=(0.0,), probes=(Probe("left", 2, target_jump=10.0),))
    experiment = Experiment("jumps", (block,), trial_seconds=seconds)
    measures = run_experiment(experiment, ["ik-dls"], subjects=1, jobs=1).measures["measure"]
    assert ({"latency", "gain"} <= set(measures)) == seen


def test_a_probe_is_measured_whatever_it_is_called() -> None:
    around = Probe("elsewhere", 2, "clamp-0", (90.0, 45.0, 135.0, 180.0))
    block = Block("learning", 48, "rotation-30", (90.0,), (around,))
    measures = run_experiment(Experiment("x", (block,)), ["mmc-body"], 1, jobs=1).measures
    assert "width" in set(measures["measure"])


def test_runs_of_other_settings_overwrite_nothing_and_are_not_mixed(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(trials, "_SUBJECTS", 2)
    agents = ["mmc-body", "ik-dls"]
    fast = run_experiment(SHORT, agents, subjects=3, out=tmp_path, rate=0.9, jobs=1)
    slow = run_experiment(SHORT, agents, subjects=2, out=tmp_path, rate=0.05, jobs=1)
    assert len(list(tmp_path.glob("trials/ik-dls--*.parquet"))) == 2  # it has no rate
    with pytest.raises(UserError, match=r"mmc-body in short .*got rate \[0\.\d+\] and \[") as error:
        read_experiments(tmp_path)
    stems = re.findall(r"(mmc-body--short\.[0-9a-f]{8})\.\*", str(error.value))
    of_fast = [stem for stem in stems if len(list(tmp_path.glob(f"trials/{stem}.*.parquet"))) == 2]
    for path in list(tmp_path.glob(f"trials/{of_fast[0]}.*")):
        path.unlink()
    (stored,) = read_experiments(tmp_path)
    rates = {name: set(of["rate"]) for name, of in stored.trials.groupby("agent")}
    assert rates == {"mmc-body": {"0.05"}, "ik-dls": {""}}
    assert set(fast.trials["rate"]) == {"0.9", ""}
    is_body = [(result.trials["agent"] == "mmc-body").to_numpy() for result in (stored, slow)]
    assert np.array_equal(stored.hands[is_body[0]], slow.hands[is_body[1]])


def test_tables_of_other_settings_are_written_next_to_each_other(tmp_path: Path) -> None:
    fast, slow = (run_experiment(SHORT, ["mmc-body"], 1, rate=rate, jobs=1) for rate in (0.9, 0.1))
    names = [result.write(tmp_path)[0].name for result in (fast, slow, fast, slow)]
    assert names == ["short.trials.csv", "short.2.trials.csv"] * 2


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("seed", {"seed": 1}),
        ("keeps_all", {"keep": ["agent"]}),
        ("speed_limit", {"env_kwargs": {"speed_limit": 5.0}}),
        ("experiment.noise", {"experiment": replace(SHORT, noise=())}),
        ("source", {"agents": {"agent": "ik-dls"}}),
    ],
)
def test_whatever_differs_is_named(tmp_path: Path, name, changed) -> None:
    usual = {"experiment": SHORT, "agents": {"agent": "mmc"}}
    for how in (usual, usual | changed):
        run_experiment(**how, subjects=1, out=tmp_path, jobs=1)
    with pytest.raises(UserError, match=f"got .*{name} .* and "):
        read_experiments(tmp_path)


def test_how_agents_went_through_is_stated_wherever_they_are(tmp_path: Path) -> None:
    shares = {"rate": (0.2, 0.02), "retention": (0.6, 1)}
    agents = ["mmc-body", "ppo-memory"]
    result = run_experiment(SHORT, agents, 1, 0, tmp_path, keep=["ppo-memory"], jobs=1, **shares)
    told = "rate 0.2, 0.02, retention 0.6, 1"
    (legend,) = result.plot().legends
    report = write_report(tmp_path, tmp_path / "report.md", format="md").read_text()
    for text in (legend.get_texts()[0].get_text(), printed(result), report):
        assert told in text
    written = [path.read_text() for path in result.write(tmp_path) if path.suffix == ".csv"]
    assert all("0.2, 0.02" in text for text in written)
    assert "keeps all" in report and set(result.trials["keeps_all"]) == {False, True}


def test_a_file_that_was_removed_is_named(tmp_path: Path) -> None:
    run_experiment(SHORT, ["mmc", "ik-dls"], subjects=1, out=tmp_path, jobs=1)
    (removed,) = tmp_path.glob("trials/mmc--*.parquet")
    content = removed.read_bytes()
    removed.unlink()
    with pytest.raises(UserError, match=f"{removed.name} is missing"):
        read_experiments(tmp_path)
    (copied,) = tmp_path.glob("trials/ik-dls--*.parquet")
    removed.write_bytes(copied.read_bytes())
    with pytest.raises(UserError, match=f"{removed.name} is damaged, .* it is ik-dls"):
        read_experiments(tmp_path)
    removed.write_bytes(content)
    assert len(read_experiments(tmp_path)) == 1
    plan = next(tmp_path.glob("trials/mmc--*.json"))
    whole = plan.read_bytes()
    flipped = [bytes([*whole[:k], whole[k] ^ 4, *whole[k + 1 :]]) for k in range(len(whole))]
    for content in (*flipped, b"[" * 100_000, b'{"subjects": 1}'):
        plan.write_bytes(content)
        with pytest.raises(UserError, match=f"{plan.name} is damaged"):
            read_experiments(tmp_path)
    plan.unlink()
    with pytest.raises(UserError, match=f"must have its {plan.name}"):
        read_experiments(tmp_path)


def test_whole_numbers_and_numbers_of_arrays_are_the_same_settings(tmp_path: Path) -> None:
    kinds = [(0.5, 0.0, 1, 2), (np.float32(0.5), 0, np.int64(1), np.int64(2)), ([0.5], [0], 1, 2)]
    for rate, retention, subjects, seed in kinds:
        settings = {"rate": rate, "retention": retention, "out": tmp_path}
        run_experiment(SHORT, ["mmc-body"], subjects, seed, jobs=1, **settings)
    assert len(list(tmp_path.glob("trials/*.parquet"))) == 1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"experiment": GRADUAL}, "'b' of .* would delay nothing"),
        ({"env_kwargs": {"perturbations": ["rotation-90"]}}, "perturbations must be left out"),
        ({"env_kwargs": {"max_episode_steps": 9}}, "max_episode_steps must be left out"),
        ({"keep": ["ppo"]}, "keep 'ppo'"),
        ({"keep": "ppo"}, "keep 'ppo'"),
        ({"keep": print}, "keep must be a name, or several, got <built-in function print>"),
        ({"out": "a\0b"}, r"out must be a path, got 'a\\x00b'"),
        ({"rate": True}, "rate must be"),
        ({"learners": {"fast": {}}}, "fast"),
        ({"learners": {"mmc-body": {"speed": 1}}}, "speed"),
        ({"learners": {"mmc-body": 3}}, "mapping"),
        ({"learners": {"mmc-body": {"rate_spread": -1}}}, "rate_spread"),
    ],
)
def test_what_cannot_be_played_is_refused_before_anything_is(wrong, message, monkeypatch) -> None:
    monkeypatch.setattr(trials, "run_cell", lambda cell: pytest.fail("played"))
    with pytest.raises(UserError, match=message):
        run_experiment(**{"experiment": SHORT, "agents": ["mmc-body"], "jobs": 1, **wrong})


def test_an_experiment_without_any_measure_is_printed_and_reported(tmp_path: Path) -> None:
    plain = Experiment("plain", (Block("baseline", 4, targets=(0.0,)),), trial_seconds=0.3)
    result = run_experiment(plain, ["ik-dls"], 1, out=tmp_path, jobs=1)
    assert "No agent has a value" in printed(result)
    result.write(tmp_path)
    for kind in ("html", "md"):
        assert "ik-dls" in write_report(tmp_path, tmp_path / "report", format=kind).read_text()


def test_agents_of_one_run_may_learn_differently_and_subjects_too(tmp_path: Path) -> None:
    agents = {"slow": "mmc-body", "alike": "mmc-body", "differ": "mmc-body"}
    how = {"slow": {"rate": 0.05}, "differ": {"rate_spread": 0.3, "retention_spread": 0.01}}
    result = run_experiment(SHORT, agents, 3, out=tmp_path, rate=0.3, learners=how, jobs=1)
    rates = {name: [*of["rate"].unique()] for name, of in result.trials.groupby("agent")}
    assert rates["slow"] == ["0.05"] and rates["alike"] == ["0.3"] and len(rates["differ"]) == 3
    again = read_experiments(tmp_path)[0].settings["differ"]
    assert again.startswith("rate 0.") and " to 0." in again


class Pulled:
    """A hand that torques pull to the target, and push aside as a share of a field needs."""

    def __init__(self, env, knows=0.0):
        self.knows = knows
        self.interface, self.limit = ReachInterface.of(env), env.unwrapped.parameters.torque_limit

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        seen = self.interface.look(observation)
        start, last, step = (seen.hand, seen.hand, 0) if state is None else state
        way, speed = seen.target - start, (seen.hand - last) / 0.02
        along = way / np.linalg.norm(way)
        force = 60 * (start + min(step / 30, 1) * way - seen.hand) - 8 * speed
        force += self.knows * 20 * (speed @ along) * np.array([-along[1], along[0]])
        segments = segments_from_joint_angles(seen.joint_angles, (1.0, 1.0, 1.0))
        nodes = node_positions(segments)[:-1]
        jacobian = np.stack([(nodes - seen.hand)[:, 1], (seen.hand - nodes)[:, 0]])
        torques = np.clip(jacobian.T @ force / self.limit, -1, 1).astype(np.float32)
        return torques, (start, seen.hand, step + 1)


def test_the_force_on_a_channel_is_the_share_of_the_field_that_was_learned() -> None:
    channel, angles = "channel-20", (0.0, 90.0, 135.0)
    blocks = (
        Block("before", 3, channel, angles),
        Block("learning", 3, "force-field-20", angles),
        Block("channel", 3, channel, angles),
    )
    how = {"env_kwargs": {"control": "joint_torque"}}
    agents = {f"{knows}": partial(Pulled, knows=knows) for knows in (0.0, 0.5, 1.0)}
    result = run_experiment(Experiment("push", blocks), agents, 1, jobs=1, **how)
    trials, is_free = result.trials, result.trials["phase"] == "learning"
    assert trials["channel_force"].isna().equals(is_free)
    learned = trials["agent"].astype(float)[~is_free].to_numpy()
    assert trials["channel_force"][~is_free].to_numpy() == pytest.approx(learned, abs=0.15)
    ways = (result.hands - result.hands[:, :1])[~is_free] @ (1, 1j)
    turn = np.exp(-1j * np.radians(trials["target_angle"][~is_free].to_numpy()))
    assert np.abs((ways * turn[:, None]).imag).max() < 0.01  # the walls hold the hand
    learning = learning_of(result.movements_of("0.0"))
    assert learning.adaptation[0, -3:] == pytest.approx(0.0, abs=1e-6)  # less that before
    assert learning.clamps[-3:].tolist() == [0.0] * 3 and (learning.errors[0, -3:] == 0).all()


def test_agents_reach_for_an_instructed_aim_and_what_remains_is_implicit() -> None:
    learning = Block("aimed", 3, "rotation-45", (90.0,), aim=-45)
    hidden = Block("after", 2, "no-feedback", (90.0,))
    experiment = Experiment("aim", (Block("baseline", 2, targets=(90.0,)), learning, hidden))
    result = run_experiment(experiment, ["mmc-body"], 1, jobs=1)
    table = result.trials
    assert table["aim"].tolist() == [0, 0, -45, -45, -45, 0, 0]
    assert table["cursor_error"][2] == pytest.approx(0.0, abs=6.0)  # the aim cancels the rotation
    ways = result.targets[:, -1] - result.hands[:, 0]
    assert np.degrees(np.arctan2(*ways.T[::-1])) == pytest.approx(90.0, abs=1e-3)
    implicit = learning_of(result.movements_of("mmc-body")).adaptation[0]
    assert 0 < implicit[3] < implicit[4] < 30 and implicit[5] > 10
    with pytest.raises(UserError, match="aim of 'a' must be 0 with a clamp, jump or channel"):
        Block("a", 8, "clamp-15", aim=10)


class Noisy(Known):
    planning_noise = 4.0


def test_your_own_learner_moves_as_it_learns(tmp_path: Path) -> None:
    blocks = (
        Block("baseline", 8),
        Block("turned", 8, "rotation-30"),
        Block("clamp", 3, "clamp-0"),
        Block("after", 2, rest=5.0, go_cue=0.1),
    )
    experiment, agents = Experiment("own", blocks), {"known": Known, "noisy": Noisy}
    result = run_experiment(experiment, agents, 2, out=tmp_path, jobs=1)
    expected, state = [], 0.0
    for trial in result.experiment.schedule:
        state = 0.5 * state if trial.rest else state
        expected.append(state)
        clamped = trial.phase == "clamp"
        state = 0.9 * state + 0.3 * (0.0 if clamped else trial.strength - state)
    of_known = result.trials["agent"] == "known"
    way = result.hands[of_known, -1] - result.hands[of_known, 0]
    turned = np.degrees(np.arctan2(way[:, 1], way[:, 0])) - result.trials["target_angle"][of_known]
    compensated = (180 - turned) % 360 - 180
    assert compensated.to_numpy() == pytest.approx(np.tile(expected, 2), abs=0.5)
    noisy = result.trials[(result.trials["agent"] == "noisy") & (result.trials["block"] == 0)]
    assert 1.5 < noisy["hand_angle"].std() < 8.0
    assert not run_experiment(experiment, {"noisy": Noisy}, 1, jobs=1).trials.empty


def test_subjects_may_be_noisy_and_differ() -> None:
    agents = {"plain": "mmc-body", "plans": "mmc-body", "moves": "mmc-body", "own": Differs}
    noise = {"plans": {"planning_noise": 4.0, "noise_spread": 0.3}, "moves": {"motor_noise": 0.1}}
    experiment = Experiment("noisy", (Block("baseline", 12, targets=(90.0,)),))
    result = run_experiment(experiment, agents, 3, learners=noise, jobs=1)
    rows = result.trials.groupby("agent")
    scatter = rows["early_hand_angle"].std()
    assert scatter["plain"] < 0.1 and 2.5 < scatter["plans"] < 6.0 and scatter["own"] > 8.0
    assert 1.0 < scatter["moves"] < 5.0
    assert rows["planning_noise"].nunique()["plans"] == 3
    assert "planning_noise" in result.settings["plans"] and "noise" not in result.settings["plain"]


def test_a_learner_is_told_no_error_where_the_cursor_is_at_rest() -> None:
    class Recorder(Known):
        seen: ClassVar[list[float]] = []

        def learn(self, error, state):
            self.seen.append(error)
            return state

    with closing(make_vec("centre-out", 2, max_episode_steps=3)) as env:
        learner = Recorder(env)
        observation, _ = env.reset(seed=0)
        _, state = learner.predict(observation, learner.begin([1, 2]))
        learner.between_trials(state)
    assert Recorder.seen == [0.0, 0.0]
