"""Models of stable-baselines3 as agents: objects, and zip files.

A model acts as it was trained: on observations normalized by the statistics of its `VecNormalize`,
and in the control mode of its environment, as far as that is known.

A zip file holds pickles, and so does a file of `VecNormalize`: loading one runs whatever code it
names.  They are loaded only if the user allows it.  The seed and the number of steps are read
without running code.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import lzma
import pickle
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import UserError, require, warn_of_mismatch
from mmc_gym.agents.base import Agent, Started, changes_contract, warn_of_another_arm, wrappers_of
from mmc_gym.interface import CannotActError, Control, ControlError, Observation, read_attribute

if TYPE_CHECKING:
    from mmc_gym.body import ArmParameters

SUFFIX = ".zip"
# What zipfile and json raise of a damaged content, one that seems encrypted included.
_DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError),
    *(KeyError, RuntimeError, ValueError),
)
# Entries that a policy is made of, and what it saw last; no others in a zip file are unpickled.
_LAST, _ORIGINAL = "_last_obs", "_last_original_obs"
_SPACES = ("observation_space", "action_space")
_NEEDED = ("policy_class", "policy_kwargs", "use_sde", *_SPACES, _LAST, _ORIGINAL)
_SAY_IT = "say --wrapper module:function (in Python: wrapper=...)"
_MEMBER_MOST = 200 * 2**20  # bytes of an entry of a zip file, unpacked


class TrainingEnvironment(NamedTuple):
    """The environment that a model was trained in; None where it is not known."""

    control: Control | None = None  #: its control mode
    body: ArmParameters | None = None  #: its arm, without perturbations
    wrappers: tuple[str, ...] = ()  #: names of wrappers that change observations or actions
    context: tuple[Any, ...] = ()  #: `observe_context` that gives the same scale; empty without it
    #: puts a single environment into the same wrappers; None where these have no such function
    wrap: Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None = None

    @classmethod
    def of(cls, env: Any) -> TrainingEnvironment:
        """Return what is known of an environment, wrapped or not."""
        try:
            known = ("control", "unperturbed", "context_scale")
            control, body, context = (read_attribute(env, name) for name in known)
        except (OSError, EOFError, UserError):  # its processes have ended, or its arms differ
            return cls()
        names = _changing_wrappers(env)
        chain = wrappers_of(env)
        wraps = [
            wrapper.single_wrapper for wrapper in chain if hasattr(type(wrapper), "single_wrapper")
        ]
        wrap = wraps[0] if len(wraps) == len(names) == 1 else None
        return cls(control, body, () if wrap else names, tuple(context or ()), wrap)


class AsTrained(gym.Wrapper[Any, Any, Any, Any]):
    """An environment in the wrappers of a model's training: the user says so, as names may differ.

    stable-baselines3's VecFrameStack, for instance, is two wrappers of Gymnasium.
    """


class ModelAgent(Agent[Any]):
    """The policy of a model, with the statistics that its observations are normalized by.

    If the model is trained further, the agent acts with its present weights and statistics.
    """

    def __init__(
        self,
        policy: Any,
        normalizer: Any,
        *,
        label: str,
        training_steps: int,
        trained_in: TrainingEnvironment,
        training_seed: int | None = None,
        lacks_statistics: bool | None = False,
    ) -> None:
        """Make the agent of a stable-baselines3 policy; the normalizer is a `VecNormalize`.

        `lacks_statistics` says whether its observations were normalized and their statistics are
        missing; None if the model does not tell.
        """
        self.label, self.training_steps, self.trained_in = label, training_steps, trained_in
        self.training_seed, self.control = training_seed, trained_in.control
        self.lacks_statistics = lacks_statistics
        self._policy, self._normalizer = policy, normalizer

    @override
    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        if self._normalizer is not None:
            observation = self._normalizer.normalize_obs(observation)
        action: NDArray[np.float32]
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        return action, state

    def load(self, normalizer: Any = None) -> ModelAgent:
        """Return the agent, with the statistics of another `VecNormalize` if one is given.

        Raise a `UserError` if it lacks those of its training.
        """
        agent = self if normalizer is None else copy(self)
        if normalizer is not None:
            agent._normalizer, agent.lacks_statistics = normalizer, False
        if agent.lacks_statistics:
            raise UserError(
                f"{self.label} must have the statistics of the VecNormalize that it was trained "
                "behind, got none: keep the file of env.save('vecnormalize.pkl') in its folder, or "
                "say --statistics FILE (in Python: statistics=..., the file or the VecNormalize)"
            )
        return agent

    def acting_in(self, env: Any) -> ModelAgent:
        """Return the agent itself if it can act in an environment.

        Warn, by a `MismatchWarning`, of another arm than in training, or that statistics may be
        missing.

        Raises:
            UserError: if it lacks statistics.
            ControlError: if its actions are of another control mode.
            CannotActError: if its observations or actions have another shape, or passed a wrapper
                in training that `env` lacks.
        """
        self.load()
        for name in _SPACES:
            trained = _shape(getattr(self._policy, name))
            here = _shape(getattr(env, f"single_{name}", getattr(env, name)))
            if trained != here:
                message = f"{name} must be of shape {trained} for {self.label}, got {here}"
                raise CannotActError(f"{message}; {_remedy(trained, here)}")
        control = read_attribute(env, "control")
        if self.control and control and control != self.control:
            raise ControlError(
                f"control must be {self.control!r} for {self.label}, got {control!r}", self.control
            )
        warn_of_another_arm(self.label, self.trained_in.body, env)
        if self.lacks_statistics is None:
            warn_of_mismatch(
                f"{self.label} does not say whether it was trained behind a VecNormalize; if it "
                "was, say --statistics FILE (in Python: statistics=...)"
            )
        if any(isinstance(wrapper, AsTrained) for wrapper in wrappers_of(env)):
            return self
        here = _changing_wrappers(env)
        if lacks := ", ".join(name for name in self.trained_in.wrappers if name not in here):
            raise CannotActError(
                f"env must be wrapped in {lacks}, as in the training of {self.label}, "
                f"got it without: {_SAY_IT}"
            )
        return self

    def parts(self) -> list[Any]:
        """Return the SHA-256 of its weights and statistics, and the classes of its policy."""
        digest = hashlib.sha256()
        for name, tensor in self._policy.state_dict().items():
            digest.update(name.encode() + tensor.detach().cpu().numpy().tobytes())
        statistics = getattr(self._normalizer, "obs_rms", None) or {}
        for rms in statistics.values() if isinstance(statistics, Mapping) else [statistics]:
            digest.update(rms.mean.tobytes() + rms.var.tobytes())
        return [digest.hexdigest(), *self.classes]

    @property
    def classes(self) -> list[type]:
        """The classes that its policy is made of, such as an extractor of features."""
        return sorted({type(part) for part in self._policy.modules()}, key=str)


def _lacks_statistics(model: Mapping[str, Any]) -> bool | None:
    """Return whether a model was trained on normalized observations; None if it does not say."""
    last, original = model.get(_LAST), model.get(_ORIGINAL)
    # Set by a training behind VecNormalize, even one of rewards alone, and off policy by each.
    if original is None or data_equivalence(last, original):
        return False
    is_outside = None if last is None else _is_outside(last, model["observation_space"])
    if "replay_buffer_class" in model:  # off policy
        return is_outside
    # The last observation of ARS is its first, hardly normalized.
    return is_outside is not False or "gae_lambda" not in model


def _is_outside(observations: Any, space: Any) -> bool | None:
    """Return whether observations are outside of their space; None if that has no bounds.

    Of normalized ones in `MMCReach-v0` that are 9,999 of 10,000 or more.
    """
    if isinstance(space, gym.spaces.Dict):
        answers = [_is_outside(observations[name], part) for name, part in space.items()]
        return None if None in answers else any(answers)
    if not space.is_bounded():
        return None
    return bool(np.any((observations < space.low) | (observations > space.high)))


def _shape(space: Any) -> Any:
    if isinstance(space, gym.spaces.Dict):
        return {name: part.shape for name, part in space.items()}
    return space.shape


def _remedy(trained: Any, here: Any) -> str:
    """Return what may be done about observations or actions of another shape."""
    if isinstance(trained, dict) and not isinstance(here, dict):
        return "let it play in MMCReachGoal-v0 (--scenarios; in Python: env or environments)"
    arguments = "--env-kwargs observe_context=... (in Python: env_kwargs)"
    return f"if it was trained with the context say {arguments}; if behind a wrapper {_SAY_IT}"


def as_agent(thing: Any) -> Any:
    """Return the agent of a model or a policy of stable-baselines3; anything else as it is."""
    if "stable_baselines3" not in sys.modules:  # nothing can be of a module that is not imported
        return thing
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy

    if not isinstance(thing, (BaseAlgorithm, BasePolicy)):
        return thing
    model: Any = thing
    env = getattr(model, "env", None)  # a model that was loaded may have none
    normalizer = None if env is None else model.get_vec_normalize_env()
    # What it saw last is of this environment; `load` and `set_env` forget it.
    is_known = normalizer is not None or (env is not None and getattr(model, _LAST) is not None)
    return ModelAgent(
        getattr(model, "policy", model),
        normalizer,
        label=type(model).__name__,
        training_steps=int(getattr(model, "num_timesteps", 0)),
        trained_in=TrainingEnvironment() if env is None else TrainingEnvironment.of(env),
        lacks_statistics=False if is_known else _lacks_statistics(vars(model)),
    )


def read_statistics(source: Any, allow_pickle: bool) -> Any:
    """Return a `VecNormalize`, as given, or from the path of its file if pickles are allowed."""
    normalizer = source
    if isinstance(source, (str, Path)):
        path = Path(source)
        normalizer = _unpickled(path, allow_pickle, lambda: pickle.loads(path.read_bytes()))
        if hasattr(normalizer, "normalize_obs"):  # what it lacks now it could not be sent without
            normalizer.__dict__ |= {"venv": None, "class_attributes": {}, "returns": None}
    accepted = "a VecNormalize, or the path of its file"
    require(hasattr(normalizer, "normalize_obs"), "statistics", source, accepted)
    return normalizer


def _unpickled(path: Path, is_allowed: bool, load: Callable[[], Any]) -> Any:
    """Return what `load` makes of a file with pickles; raise a `UserError` if it cannot."""
    if not is_allowed:
        raise UserError(
            f"'{path}' holds pickles, and to load them runs whatever code they name: if you trust "
            "the file, say --allow-pickle (in Python: allow_pickle=True)"
        )
    try:
        return load()
    except Exception as error:  # whatever unpickled code raises
        raise UserError(f"{path} cannot be loaded: {error}") from error


def _changing_wrappers(env: Any) -> tuple[str, ...]:
    """Name the wrappers that change observations or actions."""
    names = (type(wrapper).__name__ for wrapper in wrappers_of(env) if changes_contract(wrapper))
    return tuple(name for name in names if name != "VecNormalize")  # a model has its statistics


@dataclass(frozen=True)
class SavedModel:
    """A zip file of stable-baselines3, with the statistics of its `VecNormalize` in its folder."""

    path: Path  #: of the file
    allow_pickle: bool = False  #: whether its pickles may be loaded
    trained_in: ClassVar[TrainingEnvironment] = TrainingEnvironment()  #: the file does not tell

    def __getstate__(self) -> dict[str, Any]:  # each process reads the file anew
        return {"path": self.path, "allow_pickle": self.allow_pickle}

    @cached_property
    def facts(self) -> Mapping[str, Any]:
        """All entries of the file; pickled ones are not unpickled."""
        content = self.path.read_bytes()
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                for member in archive.infolist():  # no more than this is ever unpacked of it
                    if member.file_size > _MEMBER_MOST:
                        most = f"{_MEMBER_MOST:,} bytes in an entry"
                        raise ValueError(f"{member.filename} has more than {most}")
                facts = json.loads(archive.read("data"))
            if not isinstance(facts, dict) or not {"policy_class", "action_space"} <= facts.keys():
                raise ValueError("it holds no policy")
        except _DAMAGED as error:
            raise UserError(
                f"{self.path} must be a file that stable-baselines3's save wrote: {error}"
            ) from error
        return facts

    @property
    def training_seed(self) -> int | None:
        """The seed of its training; None if it is not known."""
        seed = self.facts.get("seed")
        return seed if isinstance(seed, int) and seed >= 0 else None

    @property
    def training_steps(self) -> int | None:
        """The steps of its training; None if they are not known."""
        steps = self.facts.get("num_timesteps")
        return steps if isinstance(steps, int) else None

    @cached_property
    def statistics(self) -> Path | None:
        """The file with the statistics of its `VecNormalize`; None if it has none."""
        if self.facts.get(_ORIGINAL) is None:
            return None
        folder = self.path.parent
        # rl_zoo3 has them beside its settings, in a folder named after the environment.
        of_zoo = (file.with_name("vecnormalize.pkl") for file in folder.glob("*/config.yml"))
        pickles = [file for file in (*folder.glob("*.pkl"), *of_zoo) if file.is_file()]
        # model.pkl or model_vecnormalize.pkl; and of CheckpointCallback
        # model_vecnormalize_1000_steps.pkl of model_1000_steps.zip.
        alike = [
            file for file in pickles if file.stem.replace("_vecnormalize", "") == self.path.stem
        ]
        candidates = alike or [file for file in pickles if "norm" in file.name.lower()]
        if len(candidates) > 1:
            raise UserError(
                f"{self.path} must have one file of VecNormalize in its folder, or one called "
                f"{self.path.stem}_vecnormalize.pkl, got {', '.join(map(str, sorted(candidates)))}"
            )
        return candidates[0] if candidates else None

    def parts(self) -> list[Any]:
        """Return the SHA-256 of its file and its statistics, and the classes of its policy.

        The classes are left out if its pickles may not be loaded.
        """
        statistics = b"" if self.statistics is None else self.statistics.read_bytes()
        digest = hashlib.sha256(self.path.read_bytes() + statistics).hexdigest()
        return [digest, *(self.load().classes if self.allow_pickle else [])]

    def acting_in(self, env: Any) -> ModelAgent:
        """Return its agent if it can act in an environment, see `ModelAgent.acting_in`."""
        return self.load().acting_in(env)

    def load(self, normalizer: Any = None) -> ModelAgent:
        """Load the model, if pickles are allowed: that runs the code that they name.

        A `normalizer`, which is a `VecNormalize`, takes the place of the statistics in the folder.
        """
        agent = self._without_statistics
        if normalizer is None and self.statistics is not None:
            normalizer = read_statistics(self.statistics, self.allow_pickle)
        return agent.load(normalizer)

    @cached_property
    def _without_statistics(self) -> ModelAgent:
        _ = self.facts  # read first: it names a missing or wrong file
        policy, attributes = _unpickled(self.path, self.allow_pickle, self._load_policy)
        return ModelAgent(
            policy,
            None,
            label=self.path.name,
            training_steps=self.training_steps or 0,
            trained_in=self.trained_in,
            training_seed=self.training_seed,
            lacks_statistics=_lacks_statistics(attributes),
        )

    def _load_policy(self) -> tuple[Any, dict[str, Any]]:
        """Return the policy, and the attributes of the model; those not needed are None."""
        from stable_baselines3.common.save_util import load_from_zip_file

        # Entries in `custom_objects` are not unpickled.
        others = {name: None for name in self.facts if name not in _NEEDED}
        content = io.BytesIO(self.path.read_bytes())
        data, weights, _ = load_from_zip_file(content, custom_objects=others, device="cpu")
        assert data is not None
        kind, options = data["policy_class"], dict(data.get("policy_kwargs") or {})
        more = {"lr_schedule": lambda progress: 0.0, "use_sde": data.get("use_sde")}
        taken = inspect.signature(kind).parameters  # ARS has no schedule
        options = {name: value for name, value in more.items() if value and name in taken} | options
        policy = kind(*(data[name] for name in _SPACES), **options)
        policy.load_state_dict(weights["policy"])
        return policy, data


def models_in(folder: Path) -> list[Path]:
    """Return the zip files of models in a folder; of a callback's, best_model.zip alone."""
    best = folder / "best_model.zip"
    return [best] if best.is_file() else sorted(folder.glob(f"*{SUFFIX}"))
