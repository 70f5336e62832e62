"""Let Optuna look for the constants of the network of `mmc`, or for hyperparameters of a training.

    python -m studies.learners.tuning mmc                   # 20 trials of 200,000 steps
    python -m studies.learners.tuning ppo --trials 50       # or a YAML file: my/ppo-mine.yml

Every trial is kept in a journal, and a further call resumes there.  A trial depends only on the
complete trials before it and is seeded by their number.  So interrupted tuning gives the same
trials as tuning at once.  Optuna comes with the extra `training`.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import optuna
import tyro
from optuna.samplers import TPESampler
from optuna.storages.journal import JournalFileBackend, JournalStorage
from optuna.trial import BaseTrial, FixedTrial, TrialState
from tyro.conf import Positional

from mmc_gym import UserError
from mmc_gym.agents.base import Agent
from mmc_gym.agents.mmc import MMCAgent
from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate
from mmc_gym.network import MMCNetwork
from mmc_gym.training.hyperparameters import Recipe, read_recipe
from mmc_gym.training.training import Training

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


class Target(NamedTuple):
    """Constants to tune, and how they are judged.

    Attributes:
        in_use: the constants in use; those that are not in the space are ignored.
        space: lets a trial suggest constants.
        judge: returns the part of the time at the target with these constants and that number of
            environment steps.
    """

    in_use: Constants
    space: Callable[[BaseTrial], Constants]
    judge: Callable[[Constants, int], float]


def find_target(name: str) -> Target:
    """Return the target "mmc", or that of the hyperparameters `name` (see `read_recipe`)."""
    if name == "mmc":
        return Target(NETWORK_IN_USE, _suggest_network, judge_network)
    recipe = read_recipe(name)
    settings = recipe.settings
    rate = str(recipe.hyperparameters.get("learning_rate", settings["learning_rate"]))
    in_use = {**settings, "learning_rate": float(rate.removeprefix("lin_"))}
    space = partial(_suggest_learning, in_use, rate.startswith("lin_"))
    return Target(in_use, space, partial(judge_training, recipe))


def judge_network(constants: Constants, steps: int) -> float:
    """Return the part of the time at the target of the agent "mmc" with other constants."""
    make = partial(make_network_agent, constants)
    arguments = {"control": "joint_position"}
    episodes = max(1, steps // EPISODE_STEPS)
    return evaluate(make, "MMCReach-v0", arguments, episodes, TUNING_SEED)["time_at_target"]


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
    make, arguments = partial(PolicyAgent, network, card), recipe.settings["env_kwargs"]
    scores = evaluate(make, recipe.env_id, arguments, TRAINED_EPISODES, TUNING_SEED)
    return scores["time_at_target"]


def _suggest_network(trial: BaseTrial) -> Constants:
    return {
        "damping": trial.suggest_float("damping", 2.1, 10.0),
        "velocity_damping": trial.suggest_float("velocity_damping", 1.0, 10.0),
        "velocity_decay": trial.suggest_float("velocity_decay", 0.3, 1.0),
        "iterations_per_step": trial.suggest_int("iterations_per_step", 1, 5),
    }


def _suggest_learning(in_use: Constants, falls: bool, trial: BaseTrial) -> Constants:
    """Suggest hyperparameters, from a space that includes those in use."""

    def around(name: str, low: float, high: float) -> float:
        present = in_use[name]
        return trial.suggest_float(name, min(low, present), max(high, present), log=True)

    def among(name: str, *choices: Any) -> Any:
        present = in_use[name]
        accepted = choices if present in choices else (*choices, present)
        return trial.suggest_categorical(name, accepted)

    rate = around("learning_rate", 3e-4, 3e-3)
    rate = rate if rate == in_use["learning_rate"] else float(f"{rate:.2g}")
    constants: Constants = {"learning_rate": f"lin_{rate}" if falls else rate}
    if "n_epochs" in in_use:  # PPO
        epochs = in_use["n_epochs"]
        return {
            **constants,
            # If there is no entropy bonus, we cannot know its order of magnitude.
            "ent_coef": around("ent_coef", 1e-3, 0.1) if in_use["ent_coef"] > 0 else 0.0,
            "gamma": among("gamma", 0.8, 0.9, 0.95),
            "gae_lambda": among("gae_lambda", 0.8, 0.9, 0.95),
            "batch_size": among("batch_size", 256, 512, 1024),
            "n_epochs": trial.suggest_int("n_epochs", min(3, epochs), max(10, epochs)),
        }
    return {
        **constants,
        "gamma": among("gamma", 0.8, 0.9, 0.95),
        "tau": among("tau", 0.005, 0.01, 0.03),
        "batch_size": among("batch_size", 128, 256, 512),
        "ent_coef": among("ent_coef", "auto", "auto_0.05"),
        "target_entropy": among("target_entropy", -3.0, -6.0),
    }


_CONSTANTS = "constants"  # attribute of a trial


def tune(
    name: str,
    trials: int,
    steps: int,
    out: Path | str,
    on_trial: Callable[[int, float], None] = lambda number, value: None,
) -> dict[str, Any]:
    """Look for constants; resume where an earlier call with the same arguments stopped.

    The first trial has the constants in use.  Trials and their values are kept in
    `out/NAME.journal`, the best in `out/NAME.json`.  Trials of other steps, or from when other
    constants were in use, are not comparable: they stay in the journal and are ignored.  Two
    processes must not tune the same name in the same folder at the same time.

    Args:
        name: "mmc", the name of hyperparameters that ship, or the path of your own.
        trials: their number, those of earlier calls included.
        steps: environment steps of each trial.
        out: folder.
        on_trial: called with the number and the value of each trial.

    Returns:
        The content of `out/NAME.json`.

    Raises:
        UserError: if there is no such name, nothing to try, or the journal is damaged.
    """
    if min(trials, steps) < 1:
        raise UserError(f"trials and steps must be at least 1, got {trials} and {steps}")
    target, name, out = find_target(name), Path(name).stem, Path(out)
    reference = FixedTrial(target.in_use)
    target.space(reference)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = _open_study(
        out / f"{name}.journal", json.dumps({"steps": steps, "in use": reference.params})
    )
    while len(complete := study.get_trials(states=[TrialState.COMPLETE])) < trials:
        if not complete and not study.get_trials(states=[TrialState.WAITING]):
            study.enqueue_trial(reference.params)
        seed = np.random.SeedSequence([TUNING_SEED, len(complete)]).generate_state(1)[0]
        study.sampler = TPESampler(seed=int(seed))
        trial = study.ask()
        constants = target.space(trial)
        trial.set_user_attr(_CONSTANTS, constants)
        value = target.judge(constants, steps)
        study.tell(trial, value)
        on_trial(len(complete), value)
    first, best = complete[0], study.best_trial
    result = {
        "name": name,
        "trials": len(complete),
        "steps_per_trial": steps,
        "objective": OBJECTIVE,
        "value_of_those_in_use": first.value,
        "in_use": first.user_attrs[_CONSTANTS],
        "best_value": best.value,
        "best": best.user_attrs[_CONSTANTS],
    }
    (out / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _open_study(journal: Path, name: str) -> optuna.Study:
    """Begin or resume a study; trials that were interrupted in it have failed, and run again."""
    journal.parent.mkdir(parents=True, exist_ok=True)
    try:
        study = optuna.create_study(
            storage=JournalStorage(JournalFileBackend(str(journal))),
            study_name=name,
            direction="maximize",
            load_if_exists=True,
        )
        for interrupted in study.get_trials(states=[TrialState.RUNNING]):
            study.tell(interrupted.number, state=TrialState.FAIL)
        for complete in study.get_trials(states=[TrialState.COMPLETE]):
            _ = complete.user_attrs[_CONSTANTS]
    except OSError:
        raise
    except Exception as error:  # whatever Optuna raises if the journal is damaged
        raise UserError(
            f"{journal} is no journal of Optuna, or is damaged: {type(error).__name__}: {error}"
        ) from error
    return study


def main(
    name: Positional[str],
    trials: int = 20,
    steps: int = 200_000,
    out: Path = Path("runs/tune"),
) -> None:
    """Let Optuna search for better constants; resume where it stopped.

    Args:
        name: mmc, or a name or file that `mmc-gym train` accepts.
        trials: Number of trials, those of earlier calls included.
        steps: Environment steps of each trial.
        out: Folder for trials and result.
    """

    def on_trial(number: int, value: float) -> None:
        print(f"trial {number:>3}  time at target {value:6.2%}", flush=True)

    result = tune(name, trials, steps, out, on_trial)
    print(
        f"{result['name']}: time at target {result['best_value']:.2%} with {result['best']}; "
        f"{result['value_of_those_in_use']:.2%} with the constants in use"
    )


if __name__ == "__main__":
    tyro.cli(main)
