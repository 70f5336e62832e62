"""A benchmark that was never played: movements made up so that it is known what they must say.

mmc is quick and jerky and blind to rotations; ik-dls is smooth and as blind; ppo, of two training
seeds, is smooth and hardly minds a rotation; ppo-smooth moves with minimum jerk.
"""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from mmc_gym.agents.policy import PRETRAINED
from mmc_gym.benchmark.reference import REFERENCE, minimum_jerk_episodes
from mmc_gym.benchmark.store import (
    CellKey,
    Manifest,
    NotPlayed,
    Policy,
    episodes_file,
    paths_file,
    write_cell,
    write_manifest,
)
from mmc_gym.benchmark.suite import SCENARIOS
from mmc_gym.measures import MEASURES, SET_MEASURES, Episode
from mmc_gym.report import write_report

HOSTILE = "<script>alert(1)</script>"
KEYS = ("random", "centre-out", "rotation-15", "rotation-60", "delay-100", "locked-1", "locked-2")
INSTANCES = 14
STEPS, CONTROL_STEP = 60, 0.02

# Training seeds, duration of a movement in steps, trembling, and radians lost per degree turned.
AGENTS = {
    "mmc": ((0,), 20, 0.06, 0.02),
    "mmc-closed": ((0,), 22, 0.05, 0.002),
    "ik-dls": ((0,), 30, 0.02, 0.02),
    "ppo": ((0, 1), 28, 0.02, 0.0005),
    "ppo-smooth": ((0, 1), 45, 0.0, 0.001),
    HOSTILE: ((0,), 35, 0.01, 0.01),
}
TRAINED = ("ppo", "ppo-smooth")


def hand_of(joint_angles):
    turned = np.cumsum(joint_angles, axis=-1)
    return np.stack([np.cos(turned).sum(-1), np.sin(turned).sum(-1)], axis=-1)


def episode(instance, duration, trembling, error, seed=0):
    random = np.random.default_rng([instance, 7])
    start, end = random.uniform(-1.2, 1.2, (2, 3))
    part = np.clip(np.arange(STEPS + 1) / duration, 0, 1)
    bell = part**3 * (10 - 15 * part + 6 * part**2)
    shake = trembling * np.sin(2.1 * np.arange(STEPS + 1)) * (part < 1)
    joints = start + bell[:, None] * (end + error - start) + shake[:, None]
    joints[0] = start
    noise = np.random.default_rng([instance, seed]).normal(0, 2e-4, (STEPS + 1, 3))
    joints = joints + noise
    hands, target = hand_of(joints), hand_of(end)
    return Episode(
        seed=instance,
        hands=hands,
        distances=np.linalg.norm(hands - target, axis=-1),
        targets=np.broadcast_to(target, hands.shape),
        joint_angles=joints,
        servo_impulses=np.abs(np.diff(joints, axis=0)),
        servo_work=np.abs(np.diff(joints, axis=0)),
        rewards=-np.linalg.norm(hands[1:] - target, axis=-1),
        action_times=np.full(STEPS, 1e-5),
        control_step=CONTROL_STEP,
        tolerance=0.05,
        reach=3.0,
    )


def write_store(folder, agents=AGENTS, keys=KEYS, missing=(), sources=None, instances=INSTANCES):
    """Write a store.

    Args:
        folder: of it.
        agents: what is made up of each, as in `AGENTS`.
        keys: of the environments.
        missing: (agent, training seed, environment) of cells that were not played.
        sources: what agents were made of, where it is not what they are called.
        instances: in each environment.
    """
    environments = {key: SCENARIOS[key].settings for key in keys}
    for name, (seeds, duration, trembling, lost) in agents.items():
        for key, settings in environments.items():
            error = lost * (settings["strength"] or 0) / (4 if settings["unit"] == "ms" else 1)
            for seed in seeds:
                episodes = [
                    episode(instance, duration, trembling, error, seed)
                    for instance in range(instances)
                ]
                if (name, seed, key) not in missing:
                    number = seed if is_trained(seeds) else None
                    write(folder, CellKey(name, number, key), episodes, seed == min(seeds))
    if "random" in keys:
        like = [episode(instance, 30, 0.0, 0.0) for instance in range(instances)]
        write(folder, CellKey(REFERENCE, None, "random"), minimum_jerk_episodes(like))
    skipped = NotPlayed.of(CellKey("mmc", None, "pursuit"), "skipped", "<b>no</b>")
    made_of = {name: sources_of(name, seeds) for name, (seeds, *_) in agents.items()}
    made_of |= {REFERENCE: {"0": REFERENCE}} | (sources or {})
    manifest = Manifest(
        episodes=instances,
        seed=0,
        control_step=CONTROL_STEP,
        segment_lengths=(1.0, 1.0, 1.0),
        tolerance=0.05,
        measures={name: one.facts for name, one in MEASURES.items()},
        set_measures={name: one.facts for name, one in SET_MEASURES.items()},
        environments=environments,
        agents={
            name: [
                Policy(training_seed=seed if is_trained(map(int, one)) else None, source=source)
                for seed, source in one.items()
            ]
            for name, one in made_of.items()
        },
        not_played=[skipped] if "mmc" in agents else [],
        wall_seconds={"a cell": 60.0},
        cpu_seconds={"a cell": 50.0},
        versions={"mmc-gym": "0.1.0"},
    )
    write_manifest(folder, manifest)


def is_trained(seeds):
    return not {1, 3}.isdisjoint(seeds)


def sources_of(name, seeds):
    """What an agent was made of, by training seed."""
    if name == HOSTILE:
        return {"0": "hostile:make"}
    return {str(seed): f"{name}-{seed}" if name in TRAINED else name for seed in seeds}


def write(folder, key, episodes, keeps_paths=True):
    paths = paths_file(key, episodes[:12], 3) if keeps_paths else None
    write_cell(folder, key, episodes_file(key, episodes, {}, {}), paths)


def own_policy(folder, **changes):
    """Write a copy of ppo-0 whose card has these changes; return the path of its card."""
    card = json.loads((PRETRAINED / "ppo-0.json").read_text()) | changes
    (folder / "mine.json").write_text(json.dumps(card))
    shutil.copy(PRETRAINED / "ppo-0.safetensors", folder / "mine.safetensors")
    return str(folder / "mine.json")


@pytest.fixture(scope="session")
def benchmark_store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    write_store(folder)
    return folder


@pytest.fixture(scope="session")
def make_store():
    return write_store


@pytest.fixture(scope="session")
def make_policy():
    return own_policy


@pytest.fixture(scope="session")
def report_file(benchmark_store, tmp_path_factory):
    return write_report(benchmark_store, tmp_path_factory.mktemp("report") / "report.html", 200)
