"""`MMCReach-v0` as a vector environment: many arms, stepped as arrays."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NoReturn, cast

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from mmc_gym._errors import (
    UserError,
    is_whole,
    require,
    require_array,
)
from mmc_gym.body import make_arms
from mmc_gym.body.base import ArmBatch
from mmc_gym.body.parameters import joints_that_lock
from mmc_gym.envs.arguments import VectorArguments, VectorGoalArguments, takes
from mmc_gym.envs.arms import Arms
from mmc_gym.envs.buffers import pick, put
from mmc_gym.envs.cursor import Cursor
from mmc_gym.envs.reach import GoalEnvironment, Info, with_context
from mmc_gym.envs.reward import reward_and_info
from mmc_gym.envs.setup import GoalSetup, ReachEnvironment, ReachSetup, State
from mmc_gym.envs.trials import Options
from mmc_gym.envs.workspace import (
    MOST_TARGETS,
    distances,
    places_from,
    targets_from,
    uniform_numbers,
)
from mmc_gym.interface import Seen, relative_speeds

if TYPE_CHECKING:
    from mmc_gym.body.analytic.arms import AnalyticArmBatch
    from mmc_gym.envs.compiled import CompiledStep
    from mmc_gym.envs.render import Renderer

Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]
Randoms = list[np.random.Generator]
Floats = NDArray[np.float64]
Looked = tuple[NDArray[Any], Info]  # rewards and infos
_EVERY = slice(None)


class MMCReachVectorEnv(ReachEnvironment, VectorEnv[Any, NDArray[np.float32], NDArray[Any]]):
    """Many arms of `MMCReachEnv`, array in, array out.

    `gym.make_vec("MMCReach-v0", num_envs=64)` makes one.  With the same seeds and actions it
    returns what `vectorization_mode="sync"` does, bit for bit, where numpy's `cos` and `sin` are
    those of the C library (elsewhere observations, distances and rewards may differ in the last
    bit, the movements never).  The analytic engine has its own cosines and sines, equally exact:
    its observations differ in the last bit of a float32, about once in a hundred million values.

    ## Arguments
    Those of `MMCReachEnv`, and `num_envs`, `max_episode_steps` (by default the task's; None: no
    limit), `autoreset_mode` (Gymnasium's `AutoresetMode`, or its value: "NextStep", "SameStep",
    "Disabled"), `threads` that step the arms (1), and `copy` (True: each observation is a new
    array; False: the next step overwrites it), as in Gymnasium's vector environments.  Its
    `render_mode` is "rgb_array" or None, and pictures have 160 × 160 pixels by default.

    It cannot be pickled or copied: make a new one.
    """

    metadata = {
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    @takes(VectorArguments)
    def __init__(self, arguments: VectorArguments) -> None:
        """Make the environment; the class docstrings explain the arguments."""
        self._make(ReachSetup, arguments)

    def _make(self, kind: type[ReachSetup], arguments: VectorArguments) -> None:
        self._arguments, self._kind = arguments, kind
        self.setup = self._next_setup = setup = kind(arguments)
        steps = arguments.max_episode_steps
        self.max_episode_steps = setup.task.episode_steps if steps == "task" else steps
        self.num_envs = num_envs = arguments.num_envs
        self.autoreset_mode = AutoresetMode(arguments.autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.metadata["render_fps"] = setup.frame_rate
        self.render_mode = arguments.render_mode
        self._renderers: dict[int, Renderer] = {}  # of arms in their present episodes
        self._trace: deque[Floats] = deque(maxlen=max(2, setup.frame_rate))  # hands, one second
        self.single_action_space = setup.action_space
        self.single_observation_space = space = setup.observation_space
        self.action_space = batch_space(setup.action_space, num_envs)
        self.observation_space = batch_space(space, num_envs)
        servo, bodies, threads = setup.action.servo, setup.limits.bodies, arguments.threads
        others = bodies if len(bodies) > 1 or setup.is_loaded else ()
        self._may_lock = joints_that_lock(bodies)
        self._body = make_arms(setup.engine, setup.first.body, num_envs, servo, threads, others)
        first = setup.first.numbers[None]
        self._numbers = np.tile(first, (num_envs, 1))
        self._context_shown = np.tile(setup.context_of(first), (num_envs, 1))
        self._before = np.full_like(self._numbers, np.nan)  # drawn for the episodes before
        self._context: Floats | None = None  # of all arms, (m, n), if it is known
        #: of all arms, at the present time
        self._arms = setup.first.arms.rows(np.zeros(num_envs, dtype=np.intp))
        self._cursor: Cursor | None = None
        self._lock_steps = np.tile(setup.first.arms.lock_steps, num_envs)  # and to unlock, (2, n)
        self._copy = arguments.copy
        self._all = np.arange(num_envs)
        generators = [seeding.np_random() for _ in range(num_envs)]
        self._randoms, self._seeds = map(list, zip(*generators, strict=True))
        self._paths = np.zeros((num_envs, setup.trials.path_length, 2))
        self._steps, self._places, self._last_places = np.zeros((3, num_envs), dtype=np.intp)
        self._speeds = np.zeros((num_envs, setup.joint_count))  # relative, a step earlier
        self._targets = np.zeros((num_envs, 2))
        self._is_started, self._is_over = np.zeros((2, num_envs), dtype=bool)
        self._observation: Any = create_empty_array(setup.plain_space, num_envs)
        self._unseen = np.empty((num_envs, 0), np.float32)  # of senses that change what is seen
        self._noise, self._motors, self._senses = setup.links(num_envs, setup.limits.delays)
        self._compiled: CompiledStep | None = None
        if setup.engine == "analytic":
            from mmc_gym.envs.compiled import CompiledStep  # needs numba

            self._compiled = CompiledStep(setup, cast("AnalyticArmBatch", self._body))
        # Whether a thread may take its arms through a whole step without waiting for the others.
        self._is_fused = (
            self._compiled is not None
            and setup.task.advance == "time"
            and not setup.has_cursor
            and not setup.are_senses_disturbed
            and not setup.is_timed
        )

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """Start episodes of all arms, or of those that `options["reset_mask"]`, (n,) bool, chooses.

        The first arm has the `seed`, the next `seed` + 1 and so on; or there is one for each.  The
        other options are those of `MMCReachEnv.reset`, the same for all arms, but numbers of a
        context may be (n,).  If an argument is not accepted, the arms stay as they were.
        """
        if isinstance(options, Mapping):
            options = dict(options)
        mask = options.pop("reset_mask", None) if isinstance(options, dict) else None
        mask = check_mask(mask, self.num_envs)
        arms, checked = np.flatnonzero(mask), self.setup.check_options(options, self.num_envs)
        seeds = check_seeds(seed, self.num_envs)
        seeds = [seed if is_reset else None for seed, is_reset in zip(seeds, mask, strict=True)]
        generators = [
            old if seed is None else seeding.np_random(seed)
            for *old, seed in zip(self._randoms, self._seeds, seeds, strict=True)
        ]
        before = self._before.copy()
        before[[seed is not None for seed in seeds]] = np.nan
        if checked.context is not None:
            checked.context[~mask] = np.nan
            randoms = [random for random, _ in generators]
            beyond = self.setup.episodes_beyond(checked.context, randoms, before)
            names = [strength.name for strength in self.setup.episodes.strengths]
            accepted = "such that this vector's arms can have it: make one with wider ranges"
            for arm, episode in beyond.items():
                name = f"options['context'] for arm {arm}"
                can_become = self._body.can_become(arm, episode.body)
                require(can_become, name, dict(zip(names, episode.numbers)), accepted)
                self._make_room(episode.delays)
        self._randoms, self._seeds = map(list, zip(*generators, strict=True))
        self._before = before
        self._place(arms, checked)
        self._is_started[arms], self._is_over[arms] = True, False
        _, info = self._look_at(arms)
        return self._shown(), spread(info, mask)

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Floats, Bools, Bools, Info]:
        """Hand each arm its action, (n, N), and simulate one control step.

        If an action is not accepted, the arms stay as they were.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset; or, without autoreset, if an
                episode is over.
        """
        if not self._is_started.all():
            raise ResetNeeded("call reset() before step()")
        if self.autoreset_mode == AutoresetMode.DISABLED and self._is_over.any():
            arms = np.flatnonzero(self._is_over).tolist()
            raise ResetNeeded(f"reset the arms whose episodes are over before step(): {arms}")
        waiting = np.flatnonzero(self._is_over)  # they are reset instead of stepped
        values = self._checked(actions, waiting)
        self._steps += 1
        if self._is_fused and not len(waiting):
            self._move_targets()
            rewards, info = self._move_and_look(values)
        else:
            self._move(values)
            if self.setup.is_timed:
                changed = self.setup.episodes.changed_in(self._numbers, self._steps)
                self._change(np.flatnonzero(changed))
            self._move_targets()
            if len(waiting):
                self._place(waiting, Options())
            rewards, info = self._look()
        if self.setup.limits.may_lock_in_flight:
            is_now = (self._steps == self._lock_steps) & (self._steps > 0)
            self._body.lock(np.flatnonzero(is_now[0]))
            self._body.unlock(np.flatnonzero(is_now[1]))
        rewards[waiting] = 0.0
        if self.render_mode is not None:
            self._trace.append(self._body.end_effectors.copy())
        terminations = self.setup.terminates & info["is_success"]
        terminations[waiting] = False
        truncations = self._steps >= (self.max_episode_steps or sys.maxsize)
        infos = spread(info, np.ones(self.num_envs, dtype=bool))
        over = terminations | truncations
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            self._is_over = over
        elif over.any():
            infos = self._restart(infos, over)
        return self._shown(), rewards, terminations, truncations, infos

    @override
    def _take(self, setup: ReachSetup) -> None:
        is_like = self.setup.episodes.is_like(setup.episodes) and setup.episodes.is_drawn
        names = [change.name for change in setup.episodes.changes]
        accepted = "the same perturbations with other distributions"
        require(is_like, "perturbations", names, accepted)
        accepted = f"such that only joints lock that could lock before: {sorted(self._may_lock)}"
        may_lock = joints_that_lock(setup.limits.bodies) <= self._may_lock
        require(may_lock, "perturbations", names, accepted)
        accepted = "bodies that the arms of this vector can have: make one with wider ranges"
        can_become = all(self._body.can_become(0, body) for body in setup.limits.bodies)
        require(can_become or not setup.bodies_differ, "perturbations", names, accepted)
        self.setup = setup
        self._before[:] = np.nan
        self.single_observation_space = setup.observation_space
        self.observation_space = batch_space(setup.observation_space, self.num_envs)
        self._make_room(setup.limits.delays)

    def _make_room(self, delays: Mapping[str, int]) -> None:
        """Make room for delays, control steps."""
        if self._motors is not None:
            self._motors.grow(delays["action_delay"])
        if self._senses is not None:
            self._senses.grow(delays)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of each arm, (height, width, 3); `RecordVideo` of vectors tiles them.

        Without a `render_mode` it warns and returns None.
        """
        if self.render_mode is None:
            gym.logger.warn("render() needs gym.make_vec(..., render_mode='rgb_array')")
            return None
        return tuple(self._picture(arm) for arm in self._all.tolist())

    def _picture(self, arm: int) -> NDArray[np.uint8]:
        from mmc_gym.envs.render import Renderer, Scene

        if arm not in self._renderers:
            setup, size = self.setup, (self._arguments.width, self._arguments.height)
            episode = setup.episode(self._numbers[arm]) if setup.episodes.is_drawn else setup.first
            self._renderers[arm] = Renderer(setup, episode, "rgb_array", size)
        motors = self._motors
        steps, hands = int(self._steps[arm]), [hands[arm].tolist() for hands in self._trace]
        path = self._paths[arm, : self._last_places[arm] + 1].tolist()
        scene = Scene(
            self._body.segment_angles[arm].tolist(),
            tuple(self._targets[arm].tolist()),
            trace=[(x, y) for x, y in hands[-1 - steps :]],
            path=[(x, y) for x, y in path],
            steps=steps,
            cursor=None if self._cursor is None else self._cursor.row(arm),
            observation=None if self._senses is None else self._observation[arm],
            arms=self._arms.rows([arm]),
            actions=() if motors is None else (motors.commanded[arm], motors.sent[arm]),
        )
        return cast("NDArray[np.uint8]", self._renderers[arm].draw(scene))

    @property
    def arms(self) -> ArmBatch:
        """The simulated arms, to look at: their state is true, even if senses are disturbed."""
        return self._body

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each arm."""
        return tuple(self._randoms)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each arm's generator."""
        return tuple(self._seeds)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return an attribute of each arm, or call a method, which acts on all, once."""
        value = getattr(self, f"single_{name}" if name.endswith("_space") else name)
        if name in ("np_random", "np_random_seed"):
            return tuple(value)
        if name == "context":
            return tuple({key: column[arm] for key, column in value.items()} for arm in self._all)
        return (value(*args, **kwargs) if callable(value) else value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each arm."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute to one value, or to a list of n equal ones: all arms share it."""
        of_arms = values if isinstance(values, list | tuple) else [values] * self.num_envs
        are_equal = len(of_arms) == self.num_envs and all(
            value_of_arm == of_arms[0] for value_of_arm in of_arms
        )
        require(are_equal, name, values, f"one value, or a list of {self.num_envs} equal values")
        setattr(self, name, of_arms[0])

    def close_extras(self, **kwargs: Any) -> None:
        """End the engine's threads; `close` calls this."""
        del kwargs
        self._body.close()

    def __getstate__(self) -> NoReturn:
        raise TypeError("a vector environment cannot be pickled or copied: make a new one")

    @override
    def _check_length(self, registered: EnvSpec) -> None:
        if self.max_episode_steps == registered.max_episode_steps:  # no other was given
            super()._check_length(registered)

    def _place(self, arms: Indices, options: Options) -> None:
        """Draw perturbations and a trial for each of these arms, and put it at its start."""
        setup, randoms = self.setup, [self._randoms[arm] for arm in arms.tolist()]
        episodes, more = setup.episodes, setup.joint_count + 2  # numbers of a trial
        is_together = setup.limits.have_rings and setup.trials.are_random and not options.has_trial
        count = len(episodes.strengths)
        uniform = uniform_numbers(randoms, count + more * is_together)
        numbers = episodes.numbers(uniform[:, :count], self._before[arms])
        if options.context is not None:
            context = options.context[arms]
            numbers = np.where(np.isnan(context), numbers, context)
        self._numbers[arms] = self._before[arms] = numbers
        self._context = None
        drawn = setup.first.arms.rows(0 * arms)
        if episodes.is_drawn:
            self._context_shown[arms], drawn = setup.context_of(numbers), episodes.arms(numbers)
        self._lock_steps[:, arms] = drawn.lock_steps
        self._noise.begin(arms, drawn)
        is_alone = np.full(len(arms), not is_together) | drawn.obstacles.astype(bool)
        if len(rows := np.flatnonzero(~is_alone)):
            generators = [randoms[row] for row in rows]
            trials = uniform[rows, count:]
            is_alone[rows] = ~self._place_many(arms[rows], generators, trials, drawn.rows(rows))
        if is_together:
            for row in np.flatnonzero(is_alone):
                randoms[row].bit_generator.advance(-more)
        if len(rows := np.flatnonzero(is_alone)):
            self._place_each(arms[rows], [randoms[row] for row in rows], options)
        self._arms.write(arms, drawn)
        self._steps[arms] = self._places[arms] = 0
        if setup.is_timed:
            self._change(arms)
        elif setup.has_cursor:
            self._cursor = Cursor.of(self._arms, setup.touched)
        if self._motors is not None:
            self._motors.begin(arms, setup.rest(self._body.joint_angles[arms]))
        self._body.lock(arms[self._lock_steps[0, arms] == 0])
        for arm in arms.tolist() if self._renderers else ():
            self._renderers.pop(arm, None)
        if self.render_mode is not None:
            if not self._trace:
                self._trace.append(self._body.end_effectors.copy())
            self._trace[-1][arms] = self._body.end_effectors[arms]
        self._speeds[arms] = 0.0
        self._targets[arms] = self._paths[arms, 0]
        if self.setup.channel is not None:
            self._body.confine(arms, self._body.end_effectors[arms], self._targets[arms])

    def _place_many(self, arms: Indices, randoms: Randoms, uniform: Floats, drawn: Arms) -> Bools:
        """Draw a trial for each of these arms, all at once.

        The first numbers of their generators are `uniform`, (k, N + 2).  Return which have found a
        target; the generators of the others are as before, but for these first numbers.
        """
        setup, count = self.setup, self.setup.joint_count
        locked = drawn.lockable & (self._lock_steps[0, arms] == 0)[:, None]
        postures, places = places_from(
            uniform[:, :count], drawn.ring, drawn.segment_lengths, locked if locked.any() else None
        )
        cursor = Cursor.of(drawn, setup.touched) if setup.has_cursor else None
        left, numbers = np.arange(len(arms)), uniform[:, count:]
        for tried in range(1, MOST_TARGETS + 1):
            cursors = None if cursor is None else cursor.rows(left)
            self._paths[arms[left], 0], is_reached = targets_from(numbers, places[left], cursors)
            left = left[~is_reached]
            if not len(left) or tried == MOST_TARGETS:
                break
            numbers = uniform_numbers([randoms[row] for row in left], 2)
        for row in left:
            randoms[row].bit_generator.advance(2 - 2 * MOST_TARGETS)  # type: ignore[attr-defined]
        self._last_places[arms] = 0
        body = drawn.columns(setup.episodes.touched) if setup.bodies_differ else None
        self._body.reset(postures, arms, parameters=body)
        is_found = np.ones(len(arms), dtype=bool)
        is_found[left] = False
        return is_found

    def _place_each(self, arms: Indices, randoms: Randoms, options: Options) -> None:
        """Draw a trial for each of these arms, one by one."""
        setup = self.setup
        episodes = [setup.first] * len(arms)
        if setup.episodes.is_drawn:
            episodes = [setup.episode(numbers) for numbers in self._numbers[arms]]
        trials = [
            setup.trials.draw(episode.workspace, random, options)
            for episode, random in zip(episodes, randoms, strict=True)
        ]
        for arm, trial in zip(arms, trials, strict=True):
            self._paths[arm, : len(trial.targets)] = trial.targets
            self._last_places[arm] = len(trial.targets) - 1
        bodies = [episode.body for episode in episodes] if setup.bodies_differ else None
        self._body.reset([trial.joint_angles for trial in trials], arms, parameters=bodies)

    def _change(self, arms: Indices) -> None:
        """Let the perturbations of these arms be what they are at their present steps."""
        if not len(arms):
            return
        episodes = self.setup.episodes
        self._arms.write(arms, now := episodes.arms(self._numbers[arms], self._steps[arms]))
        if self.setup.has_cursor:
            self._cursor = Cursor.of(self._arms, self.setup.touched)
        if self.setup.is_loaded:
            self._body.load(now.columns(episodes.touched), arms)

    def _move(self, values: NDArray[np.floating]) -> None:
        """Let the arms carry out their actions."""
        values = self._sent(values)
        if self._compiled is not None:
            self._compiled.move(values)
            return
        _, scale, is_relative = self.setup.action
        commands = np.multiply(values, scale, dtype=np.float64)
        self._body.command(commands + self._body.joint_angles if is_relative else commands)
        self._body.step()

    def _move_targets(self) -> None:
        """Move the targets to where they are after this step."""
        setup, last = self.setup, self._last_places
        if setup.trials.path_length == 1:
            return
        if setup.task.advance == "reach":
            hands = self._seen_hands(_EVERY)
            reached = distances(hands, self._targets) <= self.success_distance
            self._places = np.minimum(self._places + reached, last)
        elif setup.task.periodic:
            self._places = self._steps % (last + 1)
        else:
            self._places = np.minimum(self._steps, last)
        self._targets = self._paths[self._all, self._places]

    def _restart(self, infos: Info, over: Bools) -> Info:
        """Restart the arms whose episodes are over, and add their last infos (SAME_STEP)."""
        arms, shown = np.flatnonzero(over), self._with_context(self._observation)
        final_observations = np.full(self.num_envs, None, dtype=object)
        ended = pick(shown, arms)  # a copy
        for row, arm in enumerate(arms.tolist()):
            final_observations[arm] = pick(ended, row)
        names = [name for name in infos if not name.startswith("_")]
        final = spread({name: of_arms(infos[name], arms) for name in names}, over)
        self._place(arms, Options())
        _, info = self._look_at(arms)
        for name, values in info.items():
            put(infos[name], arms, values)
        ends = {"final_obs": final_observations, "final_info": final}
        return {**infos, **ends, **{f"_{name}": over.copy() for name in ends}}

    def _sent(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the actions that arrive at the servos."""
        if self._motors is None:
            return values
        return self._motors.send(values, self._arms, self._noise, self._steps - 1)

    def _look(self) -> Looked:
        """Return reward and info of all arms in their present state, and observe it."""
        if self._compiled is None:
            return self._look_at(_EVERY)
        state = self._state()
        return self._with_senses(state, *self._compiled.look(state))

    def _move_and_look(self, actions: NDArray[np.floating]) -> Looked:
        """Move the arms and look at them in one compiled pass, as `_move` and `_look` do."""
        assert self._compiled is not None
        state = self._state()
        return self._with_senses(state, *self._compiled.move_and_look(self._sent(actions), state))

    def _state(self) -> State:
        """Return the state that the compiled step needs besides that of the arms."""
        observation, senses = self._observation, self._senses
        if senses is not None:  # the observation may be written where it is sent from
            observation = self._unseen if senses.change_state else senses.late.oldest
        return State(
            self._seen_hands(_EVERY),
            self._targets,
            self._is_at_last_target(_EVERY),
            self._speeds,
            observation,
        )

    def _with_senses(self, state: State, rewards: Floats, info: Info) -> Looked:
        self._observe(_EVERY, state.hands, state.observation, info)
        return rewards, info

    def _look_at(self, arms: Indices | slice) -> Looked:
        """Return reward and info of these arms in their present state, and observe it.

        Their speeds are remembered for the cost of smoothness in the next step.
        """
        setup, targets, hands = self.setup, self._targets[arms], self._seen_hands(arms)
        speeds = relative_speeds(self._body.joint_velocities[arms], setup.given_body.speed_limit)
        observation: Any = None
        if self._senses is None or not self._senses.change_state:
            angles = self._body.joint_angles[arms]
            observation = setup.layout.encode(angles, speeds, hand=hands, target=targets)
        distance = distances(hands, targets)
        is_success = (distance <= self.success_distance) & self._is_at_last_target(arms)
        before = self._speeds[arms].T
        rewards, info = reward_and_info(
            distance, is_success, speeds.T, before, setup.reward, number=np.asarray
        )
        self._speeds[arms] = speeds
        info["end_effector"] = self._body.end_effectors[arms].copy()
        info["target"] = targets.copy()
        self._observe(arms, hands, observation, info)
        return rewards, info

    def _observe(self, arms: Indices | slice, hands: Floats, observation: Any, info: Info) -> None:
        """Let these arms observe, with disturbed senses what these make of it; complete `info`."""
        setup, senses = self.setup, self._senses
        if setup.episodes.is_drawn:
            if self._context is None:
                self._context = np.array([*self.context.values()])
            names = (strength.name for strength in setup.episodes.strengths)
            info["context"] = dict(zip(names, self._context[:, arms].copy(), strict=True))
        if setup.has_cursor:
            info["cursor"] = hands
        if setup.channel is not None:
            info["channel_force"], speeds = self._body.contacts[arms].T.copy()
            info["ideal_force"] = setup.channel * speeds
        if self._motors is not None:
            info["action_sent"] = self._motors.sent[arms].copy()
        rows, steps = self._all[arms], self._steps[arms]
        if self._noise.is_drawn:
            self._noise.draw(rows, steps, self._randoms)
        if senses is not None:
            if senses.change_state:
                angles, velocities = (
                    self._body.joint_angles[arms],
                    self._body.joint_velocities[arms],
                )
                true, positions = (
                    Seen(angles, self._targets[arms], velocities, hands),
                    self._body.end_effectors,
                )
                seen, is_seen = senses.sense(
                    rows, steps, true, self._arms, self._noise, positions[arms]
                )
                if is_seen is not None:
                    info["is_hand_seen"] = is_seen
                observation = (self._compiled or setup).observe(seen)
            observation = senses.transmit(rows, steps, observation, self._arms, self._noise)
        if len(rows) == self.num_envs:
            self._observation = observation
        else:
            put(self._observation, arms, observation)

    def _is_at_last_target(self, arms: Indices | slice) -> Bools:
        """Return which arms have their last target; only reaching that one is a success."""
        if self.setup.task.advance == "time":
            return np.ones(len(self._all[arms]), dtype=bool)
        return np.asarray(self._places[arms] == self._last_places[arms])

    def _shown(self) -> Any:
        """Return the observations that `step` and `reset` return."""
        observation = self._with_context(self._observation)
        return (
            deepcopy(observation)
            if self._copy and observation is self._observation
            else observation
        )

    def _with_context(self, observation: Any) -> Any:
        """Return the observations of all arms with the context, if that is shown."""
        return with_context(observation, self._context_shown) if self.context_size else observation

    def _seen_hands(self, arms: Indices | slice) -> Floats:
        """Return where the hands are, or the cursors that stand for them, (k, 2)."""
        hands = self._body.end_effectors[arms]
        cursor = self._cursor
        if cursor is None:
            return hands
        (x, y), targets = hands.T, self._targets[arms].T
        return np.stack(cursor.rows(arms).at(x, y, (targets[0], targets[1])), axis=-1)

    def _checked(self, actions: ArrayLike, waiting: Indices) -> NDArray[np.floating]:
        """Return the actions, (n, N), float32 or float64, with 0 for the waiting arms."""
        accepted = "numbers within -1 and 1"
        values = np.ascontiguousarray(require_array("actions", actions, accepted))
        if values.shape != self.action_space.shape:
            raise UserError(
                f"actions must have shape {self.action_space.shape}, got {values.shape}"
            )
        if len(waiting):
            values = values.copy()
            values[waiting] = 0.0
        if not (values.max() <= 1.0 and values.min() >= -1.0):  # true for NaN too
            arm = int(np.argmin((np.abs(values) <= 1.0).all(axis=-1)))
            raise UserError(
                f"actions must lie within -1 and 1, got {values[arm].tolist()} for arm {arm}"
            )
        return values


class MMCReachGoalVectorEnv(GoalEnvironment, MMCReachVectorEnv):
    """`MMCReachGoalEnv` as a vector environment; see `MMCReachVectorEnv`."""

    @takes(VectorGoalArguments)
    def __init__(self, arguments: VectorGoalArguments) -> None:
        """Make the environment; the class docstrings explain the arguments."""
        self._make(GoalSetup, arguments)


def of_arms(values: Any, arms: Indices) -> Any:
    """Return what an info has for these arms."""
    if isinstance(values, dict):
        return {name: column[arms] for name, column in values.items() if not name.startswith("_")}
    return values[arms]


def spread(info: dict[str, Any], mask: Bools) -> dict[str, Any]:
    """Return Gymnasium's vector infos: the values of the arms in the mask, zeros elsewhere."""
    infos: dict[str, Any] = {}
    everywhere = mask.all()
    masks = np.repeat(mask[None], len(info), axis=0)  # no two infos are one array
    for (name, values), is_set in zip(info.items(), masks, strict=True):
        if isinstance(values, dict):
            infos[name] = spread(values, mask)
        elif everywhere:
            infos[name] = values
        else:
            infos[name] = np.zeros((len(mask), *values.shape[1:]), values.dtype)
            infos[name][mask] = values
        infos[f"_{name}"] = is_set
    return infos


def check_mask(mask: Any, count: int) -> Bools:
    """Return the mask of the arms to reset; None selects all.  Raise a `UserError` otherwise."""
    if mask is None:
        return np.ones(count, dtype=bool)
    is_mask = isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (count,)
    accepted = f"a numpy array of {count} bools, not all False"
    require(is_mask and bool(mask.any()), "options['reset_mask']", mask, accepted)
    return np.array(mask)


def check_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed or None for each arm, or raise a `UserError`; one number starts a sequence."""
    if seed is None:
        return [None] * count
    numbers: Any = range(seed, seed + count) if is_whole(seed) else seed
    seeds = list(numbers) if np.iterable(numbers) else []
    whole = all(number is None or (is_whole(number) and number >= 0) for number in seeds)
    accepted = f"a whole number of at least 0, or {count} of them"
    require(whole and len(seeds) == count, "seed", seed, accepted)
    return [None if number is None else int(number) for number in seeds]
