"""`mmc-gym tune`: Optuna looks for constants, of learning and of the network, by one objective.

What can be tuned, and what a set of constants is worth, is in `tuning_targets`.  A tuning is kept
after each trial, and a trial depends on nothing but the complete ones before it: what it samples is
seeded by their number.  So a tuning in parts, or one that was killed at any moment, is the tuning
at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mmc_gym._files import write_atomically
from mmc_gym.training.tuning_targets import TUNING_SEED, Constants, Target, find_target

if TYPE_CHECKING:
    import optuna

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
