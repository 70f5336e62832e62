"""A benchmark that was never played: movements made up so that it is known what they must say.

mmc is quick and jerky and blind to rotations; ik-dls is smooth and as blind; ppo, of two training
seeds, is smooth and hardly minds a rotation; ppo-smooth moves with minimum jerk.
"""

from typing import NamedTuple

import numpy as np
import pytest

from mmc_gym.agents import resolve
from mmc_gym.agents.inverse_kinematics import hand_position
from mmc_gym.agents.registry import IDEAL, REFERENCE
from mmc_gym.benchmark import store
from mmc_gym.benchmark.suite import SCENARIOS, minimum_jerk_episodes
from mmc_gym.measures import MEASURES
from mmc_gym.network.time_base import minimum_jerk
from mmc_gym.report import write_report
from mmc_gym.report.results import read_results
from tests.conftest import episode_of

HOSTILE = "<script>alert(1)</script>"
KEYS = ("random", "centre-out", "rotation-15", "rotation-60", "delay-100", "locked-1", "locked-2")
INSTANCES = 14
STEPS, CONTROL_STEP = 60, 0.02
LENGTHS = (1.0, 1.0, 1.0)
WORLD = {"control_step": CONTROL_STEP, "segment_lengths": LENGTHS, "tolerance": 0.05}


class Mover(NamedTuple):
    duration: int  # steps
    trembling: float  # radians
    lost: float  # radians for each degree of a rotation
    seeds: tuple[int | None, ...] = (None,)
    source: str = ""  # if it is not made of its name


AGENTS = {
    "mmc": Mover(20, 0.06, 0.02),
    "mmc-body": Mover(22, 0.05, 0.002),
    "ik-dls": Mover(30, 0.02, 0.02),
    "ppo": Mover(28, 0.02, 0.0005, (0, 1)),
    "ppo-smooth": Mover(45, 0.0, 0.001, (0, 1)),
    HOSTILE: Mover(35, 0.01, 0.01, source="json:loads"),
}


def episode(instance, duration, trembling, error, seed=0):
    random = np.random.default_rng([instance, 7])
    start, end = random.uniform(-1.2, 1.2, (2, 3))
    part = np.clip(np.arange(STEPS + 1) / duration, 0, 1)[:, None]
    shake = trembling * np.sin(2.1 * np.arange(STEPS + 1))[:, None] * (part < 1)
    joints = start + minimum_jerk(part) * (end + error - start) + shake
    joints[0] = start
    joints += np.random.default_rng([instance, seed]).normal(0, 2e-4, (STEPS + 1, 3))
    hands, target = hand_position(joints, LENGTHS), hand_position(end, LENGTHS)
    turned = np.abs(np.diff(joints, axis=0))
    servo = {"servo_impulses": turned, "servo_work": turned}
    return episode_of(hands, target, joint_angles=joints, seed=instance, **servo)


def write_store(folder, agents=AGENTS, keys=KEYS, missing=(), instances=INSTANCES, worlds=None):
    """Write a store of agents in `AGENTS`, or of movers by name, without the `missing` cells.

    The `worlds` are other settings of environments, by name.
    """
    movers = agents if isinstance(agents, dict) else {name: AGENTS[name] for name in agents}
    worlds = {key: WORLD | (worlds or {}).get(key, {}) for key in keys}
    environments = {key: SCENARIOS[key].settings | world for key, world in worlds.items()}
    ideal = {"source": REFERENCE, "name": REFERENCE, "knowledge": IDEAL}
    policies = {REFERENCE: [store.Policy(training_seed=None, **ideal)]}
    for name, (duration, trembling, lost, seeds, source) in movers.items():
        sources = {seed: name if seed is None else f"{name}-{seed}" for seed in seeds}
        resolved = [resolve(source or policy) for policy in sources.values()]
        policies[name] = [
            store.Policy(
                training_seed=seed,
                source=agent.source_name,
                name=agent.name,
                knowledge=agent.knowledge,
                training_steps=agent.card.training_steps if agent.card else None,
            )
            for seed, agent in zip(seeds, resolved)
        ]
        for key, settings in environments.items():
            error = lost * (settings["strength"] or 0) / (4 if settings["unit"] == "ms" else 1)
            how = duration, trembling, error
            for seed in {seed for seed in seeds if (name, seed, key) not in missing}:
                episodes = [episode(instance, *how, seed or 0) for instance in range(instances)]
                write(folder, store.CellKey(name, seed, key), episodes, seed == seeds[0])
    if "random" in keys:
        like = [episode(instance, 30, 0.0, 0.0) for instance in range(instances)]
        write(folder, store.CellKey(REFERENCE, None, "random"), minimum_jerk_episodes(like))
    skipped = store.CellKey("mmc", None, "pursuit")._asdict()
    skipped = store.NotPlayed(**skipped, status="skipped", reason="<b>no</b>")
    manifest = store.Manifest(
        episodes=instances,
        seed=0,
        measures={name: measure.facts for name, measure in MEASURES.items()},
        environments=environments,
        agents=policies,
        not_played=[skipped] if "mmc" in movers else [],
        versions={"mmc-gym": "0.1.0"},
    )
    store.update_manifest(folder, lambda before: manifest)


def write(folder, key, episodes, keeps_paths=True):
    files = {store.EPISODES: store.episodes_file(key, episodes, {}, {})}
    if keeps_paths:
        files[store.PATHS] = store.paths_file(key, dict(enumerate(episodes[:12])))
    store.write_cell(folder, key, files)


@pytest.fixture(scope="session")
def benchmark_store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    write_store(folder)
    return folder


@pytest.fixture(scope="session")
def results(benchmark_store):
    return read_results(benchmark_store, resamples=200)


@pytest.fixture(scope="session")
def report_file(benchmark_store, tmp_path_factory):
    return write_report(benchmark_store, tmp_path_factory.mktemp("report") / "report.html", 200)
