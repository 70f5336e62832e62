"""`mmc-gym tune`: let Optuna look for the constants of a network, or of a training.

A `Target` says what can be tuned, and what a set of constants is worth.  `tune` keeps every trial
in a journal.  A trial depends on nothing but the complete trials before it, and is seeded by their
number: tuning that was interrupted, however often, gives the same trials.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mmc_gym._errors import UserError
from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Agent
from mmc_gym.agents.closed_loop.agent import HAND_RATE, POSTURE_WEIGHT, ClosedLoopMMCAgent
from mmc_gym.agents.closed_loop.observer import BodyObserver, Loops
from mmc_gym.agents.mmc import MMCAgent
from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate
from mmc_gym.network import MMCNetwork
from mmc_gym.training.hyperparameters import PPOSettings, Recipe, SACSettings, read_recipe
from mmc_gym.training.training import Training

if TYPE_CHECKING:
    import optuna
    from optuna.trial import BaseTrial, FrozenTrial

TUNING_SEED = 2_000_000  # of episodes and trainings: far from all others
TRAINED_EPISODES = 500
EPISODE_STEPS = 100

FEEDBACK_SCENARIOS = (
    "random",
    "force-field-60",
    "rotation-30",
    "hand-mass-10",
    "longer-20",
    "shorter-20",
    "locked-2",
    "joint-noise-0.02",
    "vision-noise-0.03",
    "delay-100",
)
"""Where feedback is tuned: nothing is wrong, feedback helps, feedback harms."""

Constants = dict[str, Any]
MakeAgent = Callable[[ReachInterface], Agent[Any]]


@dataclass(frozen=True)
class Target:
    """What is tuned.

    Attributes:
        in_use: the constants in use; others beside those of the space are ignored.
        space: lets a trial suggest constants.
        judge: what constants are worth, at most 1, after a number of environment steps.
        episodes: how many it judges by, of a number of environment steps.
        objective: what they are worth, in words.
    """

    in_use: Constants
    space: Callable[[BaseTrial], Constants]
    judge: Callable[[Constants, int], float]
    episodes: Callable[[int], int]
    objective: str = "part of the time at the target"


def find_target(name: str) -> Target:
    """Return the target "mmc", "mmc-feedback", or that of hyperparameters (see `read_recipe`).

    Raises:
        UserError: for any other name, and for hyperparameters that cannot be trained with.
    """
    if name in _NETWORKS:
        return _NETWORKS[name]
    recipe = read_recipe(name)
    settings = recipe.settings
    return Target(
        in_use={**vars(settings), "learning_rate": settings.learning_rate.start},
        space=partial(_learning, settings),
        judge=partial(_judge_training, recipe),
        episodes=lambda steps: TRAINED_EPISODES,
    )


def _network(trial: BaseTrial) -> Constants:
    return {
        "damping": trial.suggest_float("damping", 2.1, 10.0),
        "velocity_damping": trial.suggest_float("velocity_damping", 1.0, 10.0),
        "velocity_decay": trial.suggest_float("velocity_decay", 0.3, 1.0),
        "iterations_per_step": trial.suggest_int("iterations_per_step", 1, 5),
    }


def _feedback(trial: BaseTrial) -> Constants:
    """Suggest the same, with the weight of the posture taken out of the damping (see `Loops`)."""
    constants = _network(trial)
    weight = trial.suggest_float("posture_weight", 0.0, 1.0)
    return {
        **constants,
        "damping": constants["damping"] - weight,
        "posture_weight": weight,
        "hand_rate": trial.suggest_float("hand_rate", 0.0, 1.0),
    }


def _learning(settings: PPOSettings | SACSettings, trial: BaseTrial) -> Constants:
    """Suggest hyperparameters; the space includes those of the settings, wherever they are."""

    def around(name: str, low: float, high: float, value: float) -> float:
        return trial.suggest_float(name, min(low, value), max(high, value), log=True)

    def among(name: str, *choices: Any) -> Any:
        own = getattr(settings, name)
        return trial.suggest_categorical(name, choices if own in choices else (*choices, own))

    own = settings.learning_rate
    rate = around("learning_rate", 3e-4, 3e-3, own.start)
    rate = rate if rate == own.start else float(f"{rate:.2g}")
    constants: Constants = {"learning_rate": f"lin_{rate:g}" if own.falls else rate}
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


def _make_network(constants: Constants, interface: ReachInterface) -> MMCAgent:
    network = _dynamic_network(constants, interface)
    return MMCAgent(interface, network, constants["iterations_per_step"])


def _make_feedback(constants: Constants, interface: ReachInterface) -> ClosedLoopMMCAgent:
    loops = Loops(constants["posture_weight"], constants["hand_rate"])
    network = _dynamic_network(constants, interface)
    observer = BodyObserver(interface, loops)
    return ClosedLoopMMCAgent(observer, network, constants["iterations_per_step"])


def _dynamic_network(constants: Constants, interface: ReachInterface) -> MMCNetwork:
    return MMCNetwork(
        interface.segment_lengths,
        constants["damping"],
        dynamics="paper",
        velocity_damping=constants["velocity_damping"],
        velocity_decay=constants["velocity_decay"],
    )


def _judge_network(constants: Constants, steps: int) -> float:
    make = partial(_make_network, constants)
    return _time_at_target(make, "MMCReach-v0", {}, _network_episodes(steps))


def _judge_feedback(constants: Constants, steps: int) -> float:
    """Return the mean over the scenarios; their starts and targets are the same."""
    scenarios = find_scenarios(FEEDBACK_SCENARIOS).values()
    episodes = _feedback_episodes(steps) // len(FEEDBACK_SCENARIOS)
    make = partial(_make_feedback, constants)
    values = [_time_at_target(make, s.env_id, dict(s.arguments), episodes) for s in scenarios]
    return float(np.mean(values))


def _judge_training(recipe: Recipe, constants: Constants, steps: int) -> float:
    """Return how a policy does after a short training with the constants."""
    recipe = recipe.with_changes(**constants, n_timesteps=steps)
    with tempfile.TemporaryDirectory() as folder:
        training = Training(recipe, TUNING_SEED, Path(folder), evaluations=1)
        card = training.run()
        network, _ = load_policy(training.policy_files[0])
    return _time_at_target(
        lambda interface: PolicyAgent(network, card, interface),
        recipe.env_id,
        training.settings.env_kwargs,
        TRAINED_EPISODES,
    )


def _time_at_target(make: MakeAgent, env_id: str, arguments: Constants, episodes: int) -> float:
    return evaluate(make, env_id, arguments, episodes, TUNING_SEED)["time_at_target"]


def _network_episodes(steps: int) -> int:
    return max(1, steps // EPISODE_STEPS)


def _feedback_episodes(steps: int) -> int:
    """Return the episodes of all scenarios, as many in each."""
    scenarios = len(FEEDBACK_SCENARIOS)
    return max(1, steps // EPISODE_STEPS // scenarios) * scenarios


_NETWORK_IN_USE: Constants = {
    "damping": 4.0,
    "velocity_damping": 5.0,
    "velocity_decay": 0.92,
    "iterations_per_step": 3,
}

_NETWORKS = {
    "mmc": Target(_NETWORK_IN_USE, _network, _judge_network, _network_episodes),
    "mmc-feedback": Target(
        {**_NETWORK_IN_USE, "posture_weight": POSTURE_WEIGHT, "hand_rate": HAND_RATE},
        _feedback,
        _judge_feedback,
        _feedback_episodes,
        f"part of the time at the target, mean over {', '.join(FEEDBACK_SCENARIOS)}",
    ),
}


_STEPS, _CONSTANTS = "steps per trial", "constants"  # attributes of a study, and of a trial


def tune(
    name: str,
    trials: int,
    steps: int,
    out: Path,
    on_trial: Callable[[int, float], None] = lambda number, value: None,
) -> dict[str, Any]:
    """Look for constants; go on where an earlier call with the same folder stopped.

    The first trial has the constants in use; one more has them if they were others then.  Trials
    and their values are kept in `out/NAME.journal`, the best in `out/NAME.json`.  No two processes
    may tune the same in the same folder at a time.

    Args:
        name: "mmc", "mmc-feedback", the name of hyperparameters that ship, or the path of your own.
        trials: how many, those of earlier calls included.
        steps: environment steps of each trial.
        out: folder.
        on_trial: called with the number and the value of each trial.

    Returns:
        The content of `out/NAME.json`: name, trials, steps per trial, objective, episodes that it
        is taken over, value and constants of those in use, and of the best.

    Raises:
        UserError: if there is no such name, the trials in the folder have another number of steps,
            or Optuna is not installed.
    """
    for argument, count in (("trials", trials), ("steps", steps)):
        if count < 1:
            raise UserError(f"{argument} must be at least 1, got {count}")
    target, name = find_target(name), Path(name).stem
    study = _open_study(name, steps, out)
    in_use = _in_use(target)
    _end_interrupted(study)
    while (done := len(_trials(study, "COMPLETE"))) < trials or _trial_of(study, in_use) is None:
        if _trial_of(study, in_use) is None and not _trials(study, "WAITING"):
            study.enqueue_trial(in_use)
        on_trial(done, _run_trial(study, target, steps, done))
    first, best = _trial_of(study, in_use), study.best_trial
    assert first is not None
    result = {
        "name": name,
        "trials": done,
        "steps_per_trial": steps,
        "objective": target.objective,
        "episodes": target.episodes(steps),
        "value_of_those_in_use": first.value,
        "in_use": first.user_attrs[_CONSTANTS],
        "best_value": best.value,
        "best": best.user_attrs[_CONSTANTS],
    }
    write_atomically(out / f"{name}.json", json.dumps(result, indent=1) + "\n")
    return result


def _open_study(name: str, steps: int, out: Path) -> optuna.Study:
    """Open the study of that name in the folder, or begin it.

    Raises:
        UserError: if its trials have another number of steps, or Optuna is not installed.
    """
    try:
        import optuna
        from optuna.storages.journal import JournalFileBackend
    except ImportError as error:
        raise UserError('tune needs Optuna: pip install "mmc-gym[training]"') from error
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


def _run_trial(study: optuna.Study, target: Target, steps: int, done: int) -> float:
    """Run the trial after `done` complete ones, and return its value."""
    import optuna

    seed = int(np.random.SeedSequence([TUNING_SEED, done]).generate_state(1)[0])
    study.sampler = optuna.samplers.TPESampler(seed=seed)
    trial = study.ask()
    constants = target.space(trial)
    trial.set_user_attr(_CONSTANTS, constants)
    value = target.judge(constants, steps)
    study.tell(trial, value)
    return value


def _end_interrupted(study: optuna.Study) -> None:
    """Mark trials that a killed process left as failed; they are run again."""
    from optuna.trial import TrialState

    for trial in _trials(study, "RUNNING"):
        study.tell(trial.number, state=TrialState.FAIL)


def _trials(study: optuna.Study, state: str) -> list[FrozenTrial]:
    from optuna.trial import TrialState

    return study.get_trials(states=(TrialState[state],))


def _trial_of(study: optuna.Study, parameters: Constants) -> FrozenTrial | None:
    """Return the complete trial of these parameters, if there is one."""
    found = (trial for trial in _trials(study, "COMPLETE") if trial.params == parameters)
    return next(found, None)


def _in_use(target: Target) -> Constants:
    """Return the parameters of the trial that has the constants in use."""
    from optuna.trial import FixedTrial

    trial = FixedTrial(target.in_use)
    target.space(trial)
    return trial.params
