"""`mmc-gym tune`: let Optuna look for the constants of a network, or of a training.

`tune` keeps every trial in a journal.  A trial depends on nothing but the complete trials before
it, and is seeded by their number: interrupted tuning, however often, gives the same trials.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mmc_gym._errors import UserError, missing, require_whole, unknown
from mmc_gym._files import check_folder, write_atomically
from mmc_gym.agents.base import Agent
from mmc_gym.agents.mmc import MMCAgent
from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate
from mmc_gym.network import MMCNetwork
from mmc_gym.training.hyperparameters import (
    SUFFIXES,
    AnySettings,
    PPOSettings,
    Recipe,
    names,
    read_recipe,
)
from mmc_gym.training.training import Training

if TYPE_CHECKING:
    import optuna
    from optuna.trial import BaseTrial

TUNING_SEED = 2_000_000  # of episodes and trainings: far from all others
TRAINED_EPISODES = 500
EPISODE_STEPS = 100
OBJECTIVE = "part of the time at the target"

NETWORK_IN_USE = {
    "damping": 4.0,
    "velocity_damping": 5.0,
    "velocity_decay": 0.92,
    "iterations_per_step": 3,
}
Constants = dict[str, Any]


@dataclass(frozen=True)
class Target:
    """Constants to tune, and how they are judged.

    Attributes:
        in_use: the constants in use; others beside those of the space are ignored.
        space: lets a trial suggest constants.
        judge: returns the worth of constants, at most 1, after so many environment steps.
        episodes: returns how many it judges by, of so many environment steps.
    """

    in_use: Constants
    space: Callable[[BaseTrial], Constants]
    judge: Callable[[Constants, int], float]
    episodes: Callable[[int], int]


def find_target(name: str) -> Target:
    """Return the target "mmc", or that of hyperparameters (see `read_recipe`).

    Raises:
        UserError: for any other name, and for hyperparameters that cannot be trained with.
    """
    if name == "mmc":
        return Target(NETWORK_IN_USE, _suggest_network, _judge_network, _episodes)
    if name not in names() and Path(name).suffix not in SUFFIXES:
        raise unknown("name", name, ("mmc", *names()), "the path of a YAML file")
    recipe = read_recipe(name)
    settings = recipe.settings
    return Target(
        in_use={**vars(settings), "learning_rate": settings.learning_rate.start},
        space=partial(_suggest_learning, settings),
        judge=partial(judge_training, recipe),
        episodes=lambda steps: TRAINED_EPISODES,
    )


def _judge_network(constants: Constants, steps: int) -> float:
    """Return the part of the time at the target of the agent "mmc" with other constants."""
    make = partial(make_network_agent, constants)
    arguments = {"control": "joint_position"}
    return _time_at_target(make, "MMCReach-v0", arguments, _episodes(steps))


def _episodes(steps: int) -> int:
    return max(1, steps // EPISODE_STEPS)


def make_network_agent(constants: Constants, interface: ReachInterface) -> Agent[Any]:
    """Return the agent "mmc" with other constants."""
    network = MMCNetwork(
        interface.segment_lengths,
        constants["damping"],
        dynamics="paper",
        velocity_damping=constants["velocity_damping"],
        velocity_decay=constants["velocity_decay"],
    )
    return MMCAgent(interface, network, constants["iterations_per_step"])


def judge_training(recipe: Recipe, constants: Constants, steps: int) -> float:
    """Return the part of the time at the target after a short training with the constants."""
    recipe = recipe.with_changes(**constants, n_timesteps=steps)
    with tempfile.TemporaryDirectory() as folder:
        training = Training(recipe, TUNING_SEED, Path(folder), evaluations=1)
        card = training.run()
        network, _ = load_policy(training.policy_files[0])
    make = partial(PolicyAgent, network, card)
    return _time_at_target(make, recipe.env_id, training.settings.env_kwargs, TRAINED_EPISODES)


def _time_at_target(
    make: Callable[[ReachInterface], Agent[Any]],
    env_id: str,
    arguments: Mapping[str, Any],
    episodes: int,
) -> float:
    return evaluate(make, env_id, arguments, episodes, TUNING_SEED)["time_at_target"]


def _suggest_network(trial: BaseTrial) -> Constants:
    return {
        "damping": trial.suggest_float("damping", 2.1, 10.0),
        "velocity_damping": trial.suggest_float("velocity_damping", 1.0, 10.0),
        "velocity_decay": trial.suggest_float("velocity_decay", 0.3, 1.0),
        "iterations_per_step": trial.suggest_int("iterations_per_step", 1, 5),
    }


def _suggest_learning(settings: AnySettings, trial: BaseTrial) -> Constants:
    """Suggest hyperparameters; the space includes those of the settings, wherever they are."""

    def around(name: str, low: float, high: float, value: float) -> float:
        return trial.suggest_float(name, min(low, value), max(high, value), log=True)

    def among(name: str, *choices: Any) -> Any:
        own = getattr(settings, name)
        return trial.suggest_categorical(name, choices if own in choices else (*choices, own))

    own = settings.learning_rate
    rate = around("learning_rate", 3e-4, 3e-3, own.start)
    rate = rate if rate == own.start else float(f"{rate:.2g}")
    constants: Constants = {"learning_rate": f"lin_{rate}" if own.falls else rate}
    if isinstance(settings, PPOSettings):
        bonus = settings.ent_coef  # without one there is no order of magnitude to look in
        return {
            **constants,
            "ent_coef": around("ent_coef", 1e-3, 0.1, bonus) if bonus > 0 else 0.0,
            "gamma": among("gamma", 0.8, 0.9, 0.95),
            "gae_lambda": among("gae_lambda", 0.8, 0.9, 0.95),
            "batch_size": among("batch_size", 256, 512, 1024),
            "n_epochs": trial.suggest_int(
                "n_epochs", min(3, settings.n_epochs), max(10, settings.n_epochs)
            ),
        }
    return {
        **constants,
        "gamma": among("gamma", 0.8, 0.9, 0.95),
        "tau": among("tau", 0.005, 0.01, 0.03),
        "batch_size": among("batch_size", 128, 256, 512),
        "ent_coef": among("ent_coef", "auto", "auto_0.05"),
        "target_entropy": among("target_entropy", -3.0, -6.0),
    }


_STEPS, _CONSTANTS = "steps per trial", "constants"  # attributes of a study, and of a trial


def tune(
    name: str,
    trials: int,
    steps: int,
    out: Path | str,
    on_trial: Callable[[int, float], None] = lambda number, value: None,
) -> dict[str, Any]:
    """Look for constants; go on where an earlier call with the same folder stopped.

    The first trial has the constants in use; one more has them if they were others then.  Trials
    and their values are kept in `out/NAME.journal`, the best in `out/NAME.json`.  No two processes
    may tune the same in the same folder at a time.

    Args:
        name: "mmc", the name of hyperparameters that ship, or the path of your own.
        trials: how many, those of earlier calls included.
        steps: environment steps of each trial.
        out: folder.
        on_trial: called with the number and the value of each trial.

    Returns:
        The content of `out/NAME.json`.

    Raises:
        UserError: if there is no such name, the trials in the folder have another number of steps,
            or Optuna is not installed.
    """
    for argument, count in (("trials", trials), ("steps", steps)):
        require_whole(argument, count)
    out = check_folder(out, "out")
    target, name = find_target(name), Path(name).stem
    study = _open_study(name, steps, out)
    from optuna.samplers import TPESampler
    from optuna.trial import FixedTrial, TrialState

    reference = FixedTrial(target.in_use)
    target.space(reference)
    for killed in study.get_trials(states=[TrialState.RUNNING]):
        study.tell(killed.number, state=TrialState.FAIL)  # and run it again
    while True:
        complete = study.get_trials(states=[TrialState.COMPLETE])
        in_use = [trial for trial in complete if trial.params == reference.params]
        if len(complete) >= trials and in_use:
            break
        if not in_use and not study.get_trials(states=[TrialState.WAITING]):
            study.enqueue_trial(reference.params)
        seed = np.random.SeedSequence([TUNING_SEED, len(complete)]).generate_state(1)[0]
        study.sampler = TPESampler(seed=int(seed))
        trial = study.ask()
        constants = target.space(trial)
        trial.set_user_attr(_CONSTANTS, constants)
        value = target.judge(constants, steps)
        study.tell(trial, value)
        on_trial(len(complete), value)
    result = {
        "name": name,
        "trials": len(complete),
        "steps_per_trial": steps,
        "objective": OBJECTIVE,
        "episodes": target.episodes(steps),
        "value_of_those_in_use": in_use[0].value,
        "in_use": in_use[0].user_attrs[_CONSTANTS],
        "best_value": study.best_trial.value,
        "best": study.best_trial.user_attrs[_CONSTANTS],
    }
    write_atomically(out / f"{name}.json", json.dumps(result, indent=1) + "\n")
    return result


def _open_study(name: str, steps: int, out: Path) -> optuna.Study:
    """Open the study of that name in the folder, or begin it."""
    try:
        import optuna
        from optuna.storages.journal import JournalFileBackend
    except ImportError as error:
        raise missing("tune", "Optuna", "training") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    out.mkdir(parents=True, exist_ok=True)
    journal = out / f"{name}.journal"
    _drop_torn_record(journal)
    study = optuna.create_study(
        storage=optuna.storages.JournalStorage(JournalFileBackend(str(journal))),
        study_name=name,
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.set_user_attr(_STEPS, steps)
    known = study.user_attrs.get(_STEPS)
    if known != steps:
        raise UserError(
            f"steps must be those of the trials in {journal}, {known or 'which are not known'}, "
            f"for their values to be comparable, got {steps}: choose another folder"
        )
    return study


def _drop_torn_record(journal: Path) -> None:
    """Cut off the last record if it is torn, as a full disk leaves it: Optuna cannot read on."""
    if journal.exists():
        with journal.open("r+b") as file:
            file.truncate(file.read().rfind(b"\n") + 1)
