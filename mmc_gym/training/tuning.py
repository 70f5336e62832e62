"""`mmc-gym tune`: Optuna looks for constants, of learning and of the network, by one objective.

What can be tuned, and what a set of constants is worth, is in `tuning_targets`.  A tuning is kept
after each trial, and a trial depends on nothing but the complete ones before it: what it samples is
seeded by their number.  So a tuning in parts, or one that was killed at any moment, is the tuning
at once.
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
from mmc_gym.training.hyperparameters import Hyperparameters, algorithm_of, read_hyperparameters
from mmc_gym.training.training import Training

if TYPE_CHECKING:
    import optuna
    from optuna.trial import BaseTrial

TUNING_SEED = 2_000_000  # of episodes and trainings: far from all others
TRAINED_EPISODES = 500
EPISODE_STEPS = 100

UNTOLD_BODIES = (
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
"""Where feedback is tuned, by the battery's names: nothing wrong, what it mends, what harms it."""

Constants = dict[str, Any]
MakeAgent = Callable[[ReachInterface], Agent[Any]]


@dataclass(frozen=True)
class Target:
    """What is tuned.

    Attributes:
        in_use: the constants in use, as the space names them; others beside them do no harm.
        space: constants that a trial suggests, as they are put to use.
        judge: what constants are worth, of 1, after a number of environment steps.
        episodes: how many it judges by, of a number of environment steps.
        objective: what they are worth, in words.
    """

    in_use: Constants
    space: Callable[[BaseTrial], Constants]
    judge: Callable[[Constants, int], float]
    episodes: Callable[[int], int]
    objective: str = "part of the time at the target"


def find_target(name: str) -> Target:
    """The target "mmc", "mmc-feedback", or that of what there are hyperparameters for.

    Raises:
        ValueError: for any other name.
    """
    if name in _NETWORKS:
        return _NETWORKS[name]
    algorithm = algorithm_of(name)
    _, hyperparameters = read_hyperparameters(name)
    rate = str(hyperparameters["learning_rate"]).removeprefix("lin_")
    return Target(
        in_use={**hyperparameters, "learning_rate": float(rate)},
        space=partial(_LEARNING[algorithm], hyperparameters),
        judge=partial(_judge_training, name),
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
    """The same, with the damping less by the weight of the posture, as the mean has them."""
    constants = _network(trial)
    weight = trial.suggest_float("posture_weight", 0.0, 1.0)
    return {
        **constants,
        "damping": constants["damping"] - weight,
        "posture_weight": weight,
        "hand_rate": trial.suggest_float("hand_rate", 0.0, 1.0),
    }


def _ppo(hyperparameters: Hyperparameters, trial: BaseTrial) -> Constants:
    rate = trial.suggest_float("learning_rate", 3e-4, 3e-3, log=True)
    has_bonus = hyperparameters["ent_coef"] > 0  # else there is no order of magnitude to look in
    return {
        "learning_rate": f"lin_{rate:.2g}",
        "ent_coef": trial.suggest_float("ent_coef", 1e-3, 0.1, log=True) if has_bonus else 0.0,
        "gamma": trial.suggest_categorical("gamma", [0.8, 0.9, 0.95]),
        "gae_lambda": trial.suggest_categorical("gae_lambda", [0.8, 0.9, 0.95]),
        "batch_size": trial.suggest_categorical("batch_size", [256, 512, 1024]),
        "n_epochs": trial.suggest_int("n_epochs", 3, 10),
    }


def _off_policy(hyperparameters: Hyperparameters, trial: BaseTrial) -> Constants:
    rate = trial.suggest_float("learning_rate", 3e-4, 3e-3, log=True)
    return {
        "learning_rate": f"lin_{rate:.2g}",
        "gamma": trial.suggest_categorical("gamma", [0.8, 0.9, 0.95]),
        "tau": trial.suggest_categorical("tau", [0.005, 0.01, 0.03]),
        "batch_size": trial.suggest_categorical("batch_size", [128, 256, 512]),
        "ent_coef": trial.suggest_categorical("ent_coef", ["auto", "auto_0.05"]),
        "target_entropy": trial.suggest_categorical("target_entropy", [-3.0, -6.0]),
    }


_LEARNING = {"ppo": _ppo, "sac": _off_policy, "tqc": _off_policy}


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
    """The mean over the bodies, in each of which starts and targets are the same."""
    environments = find_scenarios(UNTOLD_BODIES).values()
    episodes = _feedback_episodes(steps) // len(UNTOLD_BODIES)
    make = partial(_make_feedback, constants)
    values = [_time_at_target(make, e.env_id, dict(e.arguments), episodes) for e in environments]
    return float(np.mean(values))


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
        lambda interface: PolicyAgent(network, card, interface), env_id, arguments, TRAINED_EPISODES
    )


def _time_at_target(make: MakeAgent, env_id: str, arguments: Constants, episodes: int) -> float:
    return evaluate(make, env_id, arguments, episodes, TUNING_SEED)["time_at_target"]


def _network_episodes(steps: int) -> int:
    return max(1, steps // EPISODE_STEPS)


def _feedback_episodes(steps: int) -> int:
    """As many on each body."""
    return max(1, steps // EPISODE_STEPS // len(UNTOLD_BODIES)) * len(UNTOLD_BODIES)


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
        f"part of the time at the target, mean over {', '.join(UNTOLD_BODIES)}",
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
        name: "mmc", "mmc-feedback", or a name that there are hyperparameters for.
        trials: how many, those of earlier calls included.
        steps: environment steps of each trial.
        out: folder.
        on_trial: called with the number and the value of each trial.

    Returns:
        What `out/NAME.json` holds: name, trials, steps per trial, objective, episodes that it is
        taken over, value and constants of those in use, and of the best.

    Raises:
        ValueError: if there is no such name, the trials in the folder have another number of steps,
            or Optuna is not installed.
    """
    for argument, count in (("trials", trials), ("steps", steps)):
        if count < 1:
            raise ValueError(f"{argument} must be at least 1, got {count}")
    target = find_target(name)
    study = _open_study(name, steps, out)
    in_use = _in_use(target)
    _end_interrupted(study)
    while (done := len(_complete(study))) < trials or _trial_of(study, in_use) is None:
        if _trial_of(study, in_use) is None and not _waiting(study):
            study.enqueue_trial(in_use)
        number, value = _run_trial(study, target, steps, done)
        on_trial(number, value)
    first, best = _trial_of(study, in_use), study.best_trial
    assert first is not None
    result = {
        "name": name,
        "trials": len(_complete(study)),
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
    """The study of that name in the folder, or a new one.

    Raises:
        ValueError: if its trials have another number of steps, or Optuna is not installed.
    """
    try:
        import optuna
        from optuna.storages.journal import JournalFileBackend
    except ImportError as error:
        raise ValueError('tune needs Optuna: pip install "mmc-gym[training]"') from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    out.mkdir(parents=True, exist_ok=True)
    journal = out / f"{name}.journal"
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
        raise ValueError(
            f"steps must be those of the trials in {journal}, {known or 'which are not known'}, "
            f"for their values to be comparable, got {steps}: choose another folder"
        )
    return study


def _run_trial(study: optuna.Study, target: Target, steps: int, done: int) -> tuple[int, float]:
    """Run the trial after `done` complete ones; its number among these, and its value."""
    import optuna

    seed = int(np.random.SeedSequence([TUNING_SEED, done]).generate_state(1)[0])
    study.sampler = optuna.samplers.TPESampler(seed=seed)
    trial = study.ask()
    constants = target.space(trial)
    trial.set_user_attr(_CONSTANTS, constants)
    value = target.judge(constants, steps)
    study.tell(trial, value)
    return done, value


def _end_interrupted(study: optuna.Study) -> None:
    """Mark trials as failed that a process left when it was killed; they are run again."""
    from optuna.trial import TrialState

    for trial in study.get_trials(states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)


def _complete(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    from optuna.trial import TrialState

    return study.get_trials(states=(TrialState.COMPLETE,))


def _waiting(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    from optuna.trial import TrialState

    return study.get_trials(states=(TrialState.WAITING,))


def _trial_of(study: optuna.Study, parameters: Constants) -> optuna.trial.FrozenTrial | None:
    """The complete trial of these parameters, if there is one."""
    found = (trial for trial in _complete(study) if trial.params == parameters)
    return next(found, None)


def _in_use(target: Target) -> Constants:
    """The parameters of the trial that has the constants in use."""
    from optuna.trial import FixedTrial

    trial = FixedTrial(target.in_use)
    target.space(trial)
    return trial.params
