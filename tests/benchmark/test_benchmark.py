"""A benchmark can be interrupted, added to and spread; an agent that fails is reported."""

import importlib
import platform
import shutil
import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import mmc_gym
from mmc_gym import UserError
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark import runner
from mmc_gym.benchmark.ranking import print_ranking
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import CellKey, kept_cells, read_episodes, read_manifest, read_paths
from mmc_gym.envs.names import TASKS
from mmc_gym.interface import ControlError
from mmc_gym.measures.rollout import episode_seeds, run_episodes

ENVS = ("random", "centre-out")
AGENTS_FROM_OUTSIDE = '''
import os
import numpy as np
import mmc_gym
from mmc_gym.interface import CannotActError

class Raising:
    def predict(self, *arguments, **options):
        raise RuntimeError("broken on purpose")

class Constant:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.full((*np.shape(observation)[:-1], 3), 0.5, np.float32), None

class OneByOne:
    """Acts as mmc, and takes no batches."""
    def __init__(self, env):
        self.agent = mmc_gym.make_agent("mmc", env)
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert observation.ndim == 1
        return self.agent.predict(observation, state, episode_start)

def raising(env): return Raising()
def constant(env): return Constant()
def cannot(env): raise CannotActError("env is not for me")
def crashing(env): raise ZeroDivisionError("oh")
def dying(env): os._exit(3)
'''


@pytest.fixture
def outside(tmp_path, monkeypatch):
    (tmp_path / "outside_agents.py").write_text(AGENTS_FROM_OUTSIDE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "outside_agents"
    sys.modules.pop("outside_agents", None)


def change_module(folder, old, new):
    path = folder / "outside_agents.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    sys.modules.pop("outside_agents", None)
    importlib.invalidate_caches()


def play(agents, out, environments=ENVS, episodes=4, jobs=1, **arguments):
    return benchmark(agents, out, environments, episodes, jobs=jobs, **arguments)


@pytest.fixture(scope="module")
def stored_benchmark(tmp_path_factory):
    """The store of a benchmark of mmc and the ideal hand, and its manifest; not to be changed."""
    out = tmp_path_factory.mktemp("played")
    return out, play(["mmc", REFERENCE], out, episodes=np.int64(4))


def assert_same_stores(store, other):
    """All is the same that does not depend on when, where and in which order cells were played."""
    for read in (read_episodes, read_paths):
        pd.testing.assert_frame_equal(*map(read, (store, other)))


def test_a_store_holds_the_episodes_of_rollouts(stored_benchmark):
    out, manifest = stored_benchmark
    frame = read_episodes(out).set_index(["agent", "environment"])
    assert frame.loc[("mmc", "centre-out")].shape[0] == 8  # all its trials, once each
    assert frame.loc[(REFERENCE, "random"), "success"].tolist() == [1.0] * 4
    env = gym.make("MMCReach-v0")
    alone = run_episodes(mmc_gym.make_agent("mmc", env), env, episode_seeds(0, 4))
    expected = [
        (episode.seed, episode.distances[-1], episode.servo_work.sum()) for episode in alone
    ]
    stored = frame.loc[("mmc", "random"), ["seed", "final_distance", "joint_work"]]
    np.testing.assert_allclose(stored, expected, atol=1e-9)
    assert len(read_paths(out).query("agent == 'mmc' and environment == 'centre-out'")) == 8 * 101
    assert manifest == read_manifest(out)
    assert manifest.environments["random"]["segment_lengths"] == [1.0, 1.0, 1.0]
    stems = {CellKey(agent, None, name).stem for agent in ("mmc", REFERENCE) for name in ENVS}
    assert set(manifest.cpu_seconds) == stems


def test_the_lowest_training_seed_keeps_paths_of_the_first_instances_and_failures(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(runner, "PATHS_KEPT", 1)
    monkeypatch.setattr(runner, "FAILURES_KEPT", 2)
    fails = [False, True, False, True, True]  # is it a failure?
    monkeypatch.setattr(runner, "success", lambda episode: not fails[seeds.index(episode.seed)])
    seeds = episode_seeds(0, len(fails))
    play(["x=ppo-3", "y=sac-2", "y=sac-1"], tmp_path, ["random"], len(fails))
    paths = read_paths(tmp_path)
    assert paths.groupby("agent")["training_seed"].unique().to_dict() == {"x": [3], "y": [1]}
    assert paths["instance"].unique().tolist() == [0, 1, 3]
    assert len(read_episodes(tmp_path).groupby(["agent", "training_seed"])) == 3


def test_settings_are_those_of_the_environments_that_were_played(tmp_path):
    env_kwargs = {"success_distance": 3.0, "segment_lengths": [1, 0.5], "substeps": 8}
    play(["random"], tmp_path, ["random", "longer-20", "longer-20-known"], 2, env_kwargs=env_kwargs)
    assert read_episodes(tmp_path)["success"].eq(1).all()
    worlds = read_manifest(tmp_path).environments
    assert {(world["tolerance"], world["control_step"]) for world in worlds.values()} == {
        (3.0, 0.04)
    }
    lengths = {name: world["segment_lengths"] for name, world in worlds.items()}
    assert lengths == {"random": [1, 0.5], "longer-20": [1, 0.5], "longer-20-known": [1, 0.6]}


def test_cells_that_are_there_are_not_played_again(tmp_path):
    seen = []
    play(["mmc"], tmp_path / "grown", ["random"])
    play(["mmc", "ik-dls"], tmp_path / "grown", on_progress=seen.append)
    assert seen[0].done == 1
    stems = {progress.key.stem for progress in seen[1:]}
    assert stems == {"mmc--centre-out", "ik-dls--random", "ik-dls--centre-out"}
    play(["ik-dls", "mmc"], tmp_path / "fresh")
    assert_same_stores(tmp_path / "grown", tmp_path / "fresh")


def test_a_damaged_cell_is_played_again(stored_benchmark, tmp_path):
    store = shutil.copytree(stored_benchmark[0], tmp_path / "store")
    path = store / "episodes" / "mmc--random.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    (store / "paths" / "mmc--centre-out.parquet").unlink()
    assert play(["mmc"], store).reused == 0
    assert_same_stores(store, stored_benchmark[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"episodes": 5}, "episodes is 4, asked for is 5"),
        ({"seed": 1}, "seed is 0, asked for is 1"),
        ({"agents": ["mmc=ik-dls"]}, "agent mmc is 'mmc', asked for is 'ik-dls'"),
    ],
)
def test_other_settings_are_refused(arguments, message, stored_benchmark):
    with pytest.raises(UserError, match=message):
        play(**{"agents": ["mmc"], "out": stored_benchmark[0], **arguments})


def test_another_scenario_of_the_same_name_is_refused(stored_benchmark, monkeypatch):
    monkeypatch.setitem(TASKS, "random", replace(TASKS["random"], description="other"))
    with pytest.raises(UserError, match="environment random is"):
        play(["mmc"], stored_benchmark[0], ["random"])


def test_an_agent_that_cannot_act_is_skipped_and_one_that_raises_has_failed(tmp_path, outside):
    expected = [
        ("cannot", "skipped", "env is not for me"),
        ("crashing", "failed", "ZeroDivisionError: oh"),
        ("raising", "failed", "RuntimeError: broken on purpose"),
    ]
    agents = ["mmc", *(f"{name}={outside}:{name}" for name, *_ in expected)]
    manifest = play(agents, tmp_path, ["random"])
    assert [(cell.agent, cell.status, cell.reason) for cell in manifest.not_played] == expected
    change_module(tmp_path, 'raise ZeroDivisionError("oh")', "return Constant()")
    again = play([f"crashing={outside}:crashing"], tmp_path, ["random"])
    assert {cell.agent for cell in again.not_played} == {"cannot", "raising"}
    change_module(tmp_path, "def crashing(env): return Constant()", "def crashing(env): 1 / 0")
    broken = play([f"crashing={outside}:crashing"], tmp_path, ["random"])
    reasons = {cell.agent: cell.reason for cell in broken.not_played}
    assert reasons["crashing"] == "ZeroDivisionError: division by zero"
    assert set(read_episodes(tmp_path)["agent"]) == {"mmc"}  # not what it did before


def test_of_cells_that_an_interrupted_run_has_not_reached_the_store_knows_what_it_knew(
    tmp_path, outside
):
    def interrupt(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    crashing = f"crashing={outside}:crashing"
    before = play([crashing], tmp_path, ["random"]).not_played
    with pytest.raises(KeyboardInterrupt):
        play(["mmc", crashing], tmp_path, ["random"], on_progress=interrupt)
    assert set(read_episodes(tmp_path)["agent"]) == {"mmc"}
    assert read_manifest(tmp_path).not_played == before != []


@pytest.mark.slow
def test_a_cell_under_which_processes_die_has_failed_and_the_others_are_played(tmp_path, outside):
    agents = [f"dying={outside}:dying", "mmc", "ik-dls"]
    (cell,) = play(agents, tmp_path, ["random"], jobs=2).not_played
    assert (cell.agent, cell.status) == ("dying", "failed") and "died" in cell.reason
    assert set(read_episodes(tmp_path)["agent"]) == {"mmc", "ik-dls"}


def test_an_agent_whose_module_has_changed_plays_again(tmp_path, outside, monkeypatch):
    source, seen = f"{outside}:constant", []
    play([source, "mmc"], tmp_path / "out")
    change_module(tmp_path, "import os", "# changed\nimport os")
    manifest = play([source, "mmc"], tmp_path / "out", ["random"], on_progress=seen.append)
    assert [progress.key.agent for progress in seen[1:]] == [source]
    assert manifest.reused == 1
    assert manifest.changed == [source]  # what it did in the other environment is of before
    monkeypatch.setattr("mmc_gym.agents.resolved.code_digest", lambda: "another mmc.py")
    manifest = play([source, "mmc"], tmp_path / "out")
    assert (manifest.changed, manifest.reused) == ([], 1)  # one cell of the module


def test_a_store_lists_all_versions_that_it_was_played_with(tmp_path, monkeypatch, capsys):
    now = runner.software()
    with monkeypatch.context() as earlier:
        earlier.setattr(runner, "software", lambda: {**now, "numpy": "0.0.1"})
        play(["mmc"], tmp_path, ["random"])
    manifest = play(["mmc", "ik-dls"], tmp_path, ["random"])
    assert manifest.versions["numpy"] == f"0.0.1, {now['numpy']}"
    assert manifest.versions["python"] == platform.python_version()
    print_ranking(Console(width=1000), tmp_path)
    said = capsys.readouterr().out
    assert "1 were in the store" in said
    assert f"numpy {manifest.versions['numpy']}" in said and "python" not in said


def test_two_benchmarks_may_use_one_store_at_once(tmp_path):
    """The second begins and ends while the first is playing."""

    def second(progress):
        if progress.done == 0:
            play(["ik-dls"], tmp_path, ["centre-out"])

    manifest = play(["mmc"], tmp_path, ["random"], on_progress=second)
    assert set(manifest.agents) == {"mmc", "ik-dls"}
    assert set(manifest.environments) == {"random", "centre-out"}
    assert set(manifest.cpu_seconds) == {"mmc--random", "ik-dls--centre-out"}


def test_without_anything_to_rank_the_reason_is_given(tmp_path, outside, capsys):
    play([REFERENCE], tmp_path, ENVS)
    assert print_ranking(Console(width=1000), tmp_path).empty
    assert "nothing to rank" in capsys.readouterr().out
    play([f"x={outside}:crashing"], tmp_path, ENVS)
    with pytest.raises(UserError, match="x in random, centre-out: ZeroDivisionError: oh"):
        print_ranking(Console(width=1000), tmp_path)


def test_an_agent_that_does_not_take_batches_plays_alone(tmp_path, outside):
    play([f"{outside}:OneByOne", "mmc"], tmp_path, ["random"])
    distances = read_episodes(tmp_path).groupby("agent")["final_distance"].apply(list)
    np.testing.assert_allclose(*distances, atol=1e-9)


def test_a_policy_for_other_actions_has_its_own(tmp_path, frozen):
    def limp(env):
        if env.unwrapped.control != "joint_torque":
            raise ControlError("control must be 'joint_torque'", "joint_torque")
        return frozen

    play({"limp": limp}, tmp_path, ["random"], 2)
    assert kept_cells(tmp_path)["limp--random"].facts["control"] == "joint_torque"
