"""`mmc-gym tune`: Optuna looks for constants, of learning and of the network, by one objective.

A trial is worth the part of the time that the agent spends at the target, over episodes that serve
for nothing else: it counts arriving, arriving soon, and staying.  Each trial has the same number
of environment steps, for learning agents those of a short training, for the network, which learns
nothing, those of the episodes that it is judged by.  Trainings use seeds from `TUNING_SEED` on, so
that what ships and what is compared is trained and played with fresh ones.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Agent, ReachInterface
from mmc_gym.agents.hyperparameters import algorithm_of, read_hyperparameters
from mmc_gym.agents.mmc import MMCAgent
from mmc_gym.agents.reinforcement import PolicyAgent, load_policy
from mmc_gym.agents.training import Training, evaluate_agent
from mmc_gym.network import MMCNetwork

if TYPE_CHECKING:
    import optuna

TUNING_SEED = 2_000_000  # of episodes and trainings: far from all others
EPISODES = 500
EPISODE_STEPS = 100

Constants = dict[str, Any]


def _network(trial: optuna.Trial) -> Constants:
    return {
        "damping": trial.suggest_float("damping", 2.1, 10.0),
        "velocity_damping": trial.suggest_float("velocity_damping", 1.0, 10.0),
        "velocity_decay": trial.suggest_float("velocity_decay", 0.3, 1.0),
        "iterations_per_step": trial.suggest_int("iterations_per_step", 1, 5),
    }


def _ppo(trial: optuna.Trial) -> Constants:
    rate = trial.suggest_float("learning_rate", 3e-4, 3e-3, log=True)
    return {
        "learning_rate": f"lin_{rate:.2g}",
        "ent_coef": trial.suggest_float("ent_coef", 1e-3, 0.1, log=True),
        "gamma": trial.suggest_categorical("gamma", [0.8, 0.9, 0.95]),
        "gae_lambda": trial.suggest_categorical("gae_lambda", [0.8, 0.9, 0.95]),
        "batch_size": trial.suggest_categorical("batch_size", [256, 512, 1024]),
        "n_epochs": trial.suggest_int("n_epochs", 3, 10),
    }


def _off_policy(trial: optuna.Trial) -> Constants:
    rate = trial.suggest_float("learning_rate", 3e-4, 3e-3, log=True)
    return {
        "learning_rate": f"lin_{rate:.2g}",
        "gamma": trial.suggest_categorical("gamma", [0.8, 0.9, 0.95]),
        "tau": trial.suggest_categorical("tau", [0.005, 0.01, 0.03]),
        "batch_size": trial.suggest_categorical("batch_size", [128, 256, 512]),
        "ent_coef": trial.suggest_categorical("ent_coef", ["auto", "auto_0.05"]),
        "target_entropy": trial.suggest_categorical("target_entropy", [-3.0, -6.0]),
    }


NETWORK = "mmc"
SPACES: Mapping[str, Callable[[optuna.Trial], Constants]] = {
    NETWORK: _network,
    "ppo": _ppo,
    "sac": _off_policy,
    "tqc": _off_policy,
}


def tune(
    name: str,
    trials: int,
    steps: int,
    out: Path,
    on_trial: Callable[[int, float], None] = lambda number, value: None,
) -> dict[str, Any]:
    """Look for constants; go on where an earlier call with the same folder stopped.

    The first trial has the constants in use.  Trials and their values are kept in
    `out/NAME.journal`, the best in `out/NAME.json`.

    Args:
        name: "mmc", or a name that there are hyperparameters for.
        trials: how many, those of earlier calls included.
        steps: environment steps of each trial.
        out: folder.
        on_trial: called with the number and the value of each trial.

    Returns:
        What `out/NAME.json` holds: name, trials, steps per trial, objective, the first value, the
        best value and constants.

    Raises:
        ValueError: if there is no such name, or Optuna is not installed.
    """
    try:
        import optuna
        from optuna.storages.journal import JournalFileBackend
    except ImportError as error:
        raise ValueError('tune needs Optuna: pip install "mmc-gym[training]"') from error
    for argument, value in (("trials", trials), ("steps", steps)):
        if value < 1:
            raise ValueError(f"{argument} must be at least 1, got {value}")
    kind = NETWORK if name == NETWORK else algorithm_of(name)
    in_use = _in_use(name)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    out.mkdir(parents=True, exist_ok=True)
    journal = JournalFileBackend(str(out / f"{name}.journal"))
    study = optuna.create_study(
        storage=optuna.storages.JournalStorage(journal),
        study_name=name,
        sampler=optuna.samplers.TPESampler(seed=TUNING_SEED),
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(in_use)

    def objective(trial: optuna.Trial) -> float:
        constants = SPACES[kind](trial)
        if name == NETWORK:
            return _judge_network(constants, steps)
        return _judge_training(name, constants, steps)

    while (done := _complete(study)) < trials:
        study.optimize(objective, n_trials=1)
        on_trial(done, float(study.trials[-1].value or 0.0))
    first = next(trial for trial in study.trials if trial.state.is_finished())
    result = {
        "name": name,
        "trials": _complete(study),
        "steps_per_trial": steps,
        "objective": "part of the time at the target",
        "episodes": steps // EPISODE_STEPS if name == NETWORK else EPISODES,
        "value_of_those_in_use": first.value,
        "best_value": study.best_value,
        "best": study.best_params,
    }
    write_atomically(out / f"{name}.json", json.dumps(result, indent=1) + "\n")
    return result


def _complete(study: optuna.Study) -> int:
    return sum(trial.value is not None for trial in study.trials)


def _in_use(name: str) -> Constants:
    """The constants in use, as the search spaces have them."""
    if name == NETWORK:
        return {
            "damping": 4.0,
            "velocity_damping": 5.0,
            "velocity_decay": 0.92,
            "iterations_per_step": 3,
        }
    _, hyperparameters = read_hyperparameters(name)
    constants = dict(hyperparameters)
    if isinstance(constants["learning_rate"], str):
        constants["learning_rate"] = float(constants["learning_rate"].removeprefix("lin_"))
    return constants


def _judge_network(constants: Constants, steps: int) -> float:
    """How an MMC agent with the constants does."""

    def make(interface: ReachInterface) -> Agent[Any]:
        network = MMCNetwork(
            interface.segment_lengths,
            constants["damping"],
            dynamics="paper",
            velocity_damping=constants["velocity_damping"],
            velocity_decay=constants["velocity_decay"],
        )
        return MMCAgent(interface, network, constants["iterations_per_step"])

    episodes = max(1, steps // EPISODE_STEPS)
    return _time_at_target(make, "MMCReach-v0", {}, episodes)


def _judge_training(name: str, constants: Constants, steps: int) -> float:
    """How an agent does after a short training with the constants."""
    env_id, hyperparameters = read_hyperparameters(name)
    hyperparameters |= {**constants, "n_timesteps": steps}
    with tempfile.TemporaryDirectory() as folder:
        training = Training(name, hyperparameters, env_id, TUNING_SEED, Path(folder), evaluations=1)
        card = training.run()
        network, _ = load_policy(Path(folder) / f"{card.file_stem}.json")
    arguments = hyperparameters.get("env_kwargs", {})
    return _time_at_target(
        lambda interface: PolicyAgent(network, card, interface), env_id, arguments, EPISODES
    )


def _time_at_target(
    make: Callable[[ReachInterface], Agent[Any]], env_id: str, arguments: Constants, episodes: int
) -> float:
    return evaluate_agent(make, env_id, arguments, episodes, TUNING_SEED)["time_at_target"]
