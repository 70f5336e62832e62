"""`MMCReach-v0`: a planar arm reaches for a target and stays there."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from mmc_gym._errors import UserError, require_array
from mmc_gym.body import make_arm
from mmc_gym.body.base import SingleArm
from mmc_gym.envs.arguments import RENDER_MODES, SingleArguments, SingleGoalArguments, takes
from mmc_gym.envs.cursor import Cursor
from mmc_gym.envs.reward import precision, reward_and_info
from mmc_gym.envs.setup import Episode, GoalSetup, ReachEnvironment, ReachSetup
from mmc_gym.envs.trials import check_target, require_finite_numbers
from mmc_gym.envs.workspace import Point, distances
from mmc_gym.interface import Seen, relative_speeds

if TYPE_CHECKING:
    from mmc_gym.envs.render import Renderer

Floats = NDArray[np.float64]
Info = dict[str, Any]
_FIRST = np.zeros(1, dtype=np.intp)  # of the only arm


class MMCReachEnv(ReachEnvironment, gym.Env[Any, NDArray[np.float32]]):
    """A planar arm of three segments reaches for a target and stays there.

    ## Description
    Three uniform rods of length 1 and mass 1 with continuous joints lie in a horizontal plane,
    simulated by pymunk in control steps of 0.02 s (four physics steps of 0.005 s).  As in real
    arms, each segment also turns the rotor of its drive, which has a quarter of the inertia that it
    moves; this lets the solver come near the exact movement in a few sweeps.  A servo at each joint
    follows the action with at most 2π rad/s and a torque of at most 500
    (mass · length² / s²): the stretched arm turns by 90° in 0.40 s, to within 0.05 rad.
    Arms of more or longer segments get stronger servos (`ArmParameters.torque_limit`).

    ## Action Space
    `Box(-1, 1, (3,), float32)`, from the base outward.  `control` says what it means:

    | control | an action a asks for |
    | --- | --- |
    | `joint_delta` (default) | the present joint angle + (2π/12)·a: turns at 0.85 · 2π·a rad/s |
    | `joint_position` | the joint angle π·a, the short way round |
    | `joint_velocity` | the joint velocity 2π·a, rad/s |
    | `joint_torque` | the torque 500·a, until the joint turns at 2π rad/s |

    Actions outside the Box raise an error and are not clipped (stable-baselines3 clips by itself;
    for others there is `gymnasium.wrappers.ClipAction`).

    ## Observation Space
    `Box((15,), float32)`:

    | index | observation | within |
    | --- | --- | --- |
    | 0–2 | cos of the joint angles | ±1 |
    | 3–5 | sin of the joint angles | ±1 |
    | 6–8 | joint velocities / 2π rad/s, clipped | ±1 |
    | 9–10 | target (x, y), segment lengths | ±3 |
    | 11–12 | target − hand, segment lengths | ±6 |
    | 13–14 | (target − hand) / (0.05 + distance) | ±1 |

    From index 9 on, vectors are in the frame whose x axis is the first segment: a learner need not
    learn that reaching is the same in every direction.  The last two enlarge small distances, where
    success is decided.

    ## Rewards
    Dense (default): −distance + 0.05 / (0.05 + distance) − mean((joint velocity / 2π)²); the
    distance is that from hand to target in segment lengths.  A `smoothness_weight` w adds
    −w · mean(change of joint velocity / 2π over the step, squared).  Sparse: 0 within 0.05 of the
    target, −1 elsewhere.

    ## Starting State
    Joint angles are uniform on the circle, at rest; the target is area-uniform over the disc (for
    unequal segments: the ring) that the hand can reach.  `reset(options={"joint_angles": …})` (3
    angles in radians) and `{"target": (x, y)}` set them.  Other tasks start in other ways; if
    their trials are numbered (`setup.task.trial_count`), `{"trial": k}` selects one.

    ## Episode End
    Episodes do not terminate: the hand must stay at the target.  With `terminate_on_success` they
    do where it reaches the target (`is_success`).  `gym.make` truncates them after the task's
    number of steps: 100 (2 s), `pursuit` 500, `via-points` 200.

    ## Information
    `reset` and `step` return `distance`, `is_success` (distance ≤ 0.05; with via points only at
    the last), `end_effector`, `target`, and the terms of the dense reward, `reward_distance`,
    `reward_precision`, `reward_control` and, if it has a weight, `reward_smoothness`.  All are
    true, even if the senses are disturbed.  Under a visuomotor rotation a `cursor` stands for the
    hand; distance, success and reward are the cursor's.  If motors fail, `action_sent` is what
    arrived at the servos.

    ## Tasks and Perturbations
    `task` says where the target is and how it moves; every task has an id, such as
    `MMCReachPursuit-v0`.  `perturbations` names what goes wrong with motors, body, cursor or
    senses, with any strength: `["delay-160", "longer-35-known"]`.
    `mmc_gym.make("pursuit+delay-160")` makes both by one name.  See `mmc_gym.envs.names`.
    `env.unwrapped.parameters` is the arm that agents are given.

    ## Arguments
    `control`, `reward_type` ("dense", "sparse"), `control_weight`, `precision_weight`,
    `smoothness_weight`, `success_distance`, `terminate_on_success`, `render_mode` ("human",
    "rgb_array"), `width` and `height` of pictures, `task` (a name or a `Task`; by name only tasks
    with the id's number of steps), `perturbations` (names or `Change`s), `observe_context`,
    `engine` ("pymunk", "analytic"), and the fields of `mmc_gym.body.ArmParameters`; the signature
    has the defaults.  The arm has as many joints as `segment_lengths`; action and observation grow
    with it.

    ## Drawn Perturbations
    The strength of a perturbation may be a range (`"rotation--60..60"`) or a frozen distribution of
    scipy.stats (`VisuomotorRotation(uniform(-60, 120))`), and a perturbation `OneOf` several: each
    episode draws its own.  `context` and `info["context"]` have what was drawn;
    `reset(options={"context": {"rotation": 30}})` sets it.  `observe_context=True`
    appends it to the observation, scaled to ±1, for agents that are trained with it;
    `observe_context="rotation--60..60"` does so on that scale, whatever the perturbations are.
    `env.unwrapped.set_perturbations(…)` sets what later episodes draw from, while the scale stays:
    what lies beyond is beyond ±1.  From a `Walk` an arm's next episode draws what follows from its
    last one.

    A pickled or deep-copied environment continues from its state, bit for bit as the original
    does; it has no window.  Long after the last reset it cannot be copied, see
    `mmc_gym.body.PymunkArm`.

    ## Version History
    * v0: initial version
    """

    metadata = {"render_modes": [*RENDER_MODES], "render_fps": 50}

    @takes(SingleArguments)
    def __init__(self, arguments: SingleArguments) -> None:
        self._make(ReachSetup, arguments)

    def _make(self, kind: type[ReachSetup], arguments: SingleArguments) -> None:
        self._arguments, self._kind = arguments, kind
        self.setup = self._next_setup = setup = kind(arguments)
        self.render_mode = arguments.render_mode
        self.metadata = {**type(self).metadata, "render_fps": setup.frame_rate}
        self.action_space = setup.action_space
        self._action_shape = setup.action_space.shape
        self.observation_space = setup.observation_space
        self._arm = make_arm(setup.engine, setup.first.body, setup.action.servo)
        self._renderer: Renderer | None = None
        self._begin(setup, setup.first)
        self._speeds: list[float] = []  # of the joints a step earlier, as fractions of their limit
        self._trace: deque[Point] = deque(maxlen=max(2, setup.frame_rate))  # one second
        self._ghost: list[float] | None = None
        self._is_started = False
        self._before: Floats | None = None  # numbers drawn for the last episode, (1, m)
        self._place([0.0] * setup.joint_count, [(setup.reach, 0.0)])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Start an episode: see "Starting State" in the class docstring.

        If an option is not accepted, the environment stays as it was.
        """
        setup = self._next_setup
        checked = setup.check_options(options)
        if checked.context is not None:
            random = self.np_random if seed is None else seeding.np_random(seed)[0]
            setup.episodes_beyond(checked.context, [random], self._before if seed is None else None)
        super().reset(seed=seed)
        if setup.episodes.is_drawn:
            before = self._before if seed is None else None
            self._before = setup.episodes.drawn([self.np_random], checked.context, before)
            self._begin(setup, setup.episode(self._before[0]))
        elif self.setup is not setup:
            self._begin(setup, setup.first)
        self._is_started = True
        self._place(*setup.trials.draw(self.episode.workspace, self.np_random, checked))
        observation, _, info = self._look_and_reward()
        if self._has_context:
            observation = self._with_context(observation, info)
        if self.render_mode == "human":
            self.render()
        return observation, info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hand the action to the servos and simulate one control step.

        If the action is not accepted, the environment stays as it was.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if not self._is_started:
            raise ResetNeeded("call reset() before step()")
        arm, setup = self._arm, self.setup
        command = self._command(action)
        if setup.action.is_relative:
            command = [angle + delta for angle, delta in zip(arm.joint_angles, command)]
        arm.command(command)
        arm.step()
        if self.render_mode is not None:
            self._trace.append(arm.end_effector)
        if self._has_events:
            self._advance_events()
        observation, reward, info = self._look_and_reward()
        if self._has_context:
            observation = self._with_context(observation, info)
        if self.render_mode == "human":
            self.render()
        return observation, reward, setup.terminates and bool(info["is_success"]), False, info

    @override
    def _take(self, setup: ReachSetup) -> None:
        super()._take(setup)
        self._before = None

    @property
    def arm(self) -> SingleArm:
        """The simulated arm, for reading; its state is true, even if the senses are disturbed."""
        return self._arm

    def set_target(self, target: ArrayLike) -> None:
        """Move the target to (x, y) during an episode; the next step observes and rewards it.

        The target stays there, whatever the task.  A point out of reach raises a `UserError`, and
        the target stays where it was.
        """
        self._targets = [check_target("target", target, self.episode.workspace)]
        self._target = self._targets[0]

    def show_posture(self, joint_angles: ArrayLike | None) -> None:
        """Draw a second arm into the following pictures, such as that of an internal model.

        `joint_angles` are its N relative angles in radians; None draws no second arm.
        """
        if joint_angles is not None:
            count = self.setup.joint_count
            joint_angles = require_finite_numbers("joint_angles", joint_angles, count)
        self._ghost = joint_angles

    def render(self) -> NDArray[np.uint8] | None:
        """Return the picture (height, width, 3) for "rgb_array"; show it for "human"."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: gym.make(..., render_mode='rgb_array')")
            return None
        from mmc_gym.envs.render import Renderer, Scene

        if self._renderer is None:
            size = self._arguments.width, self._arguments.height
            self._renderer = Renderer(self.setup, self.episode, self.render_mode, size)
        motors = self._motors
        scene = Scene(
            self._arm.segment_angles,
            self._target,
            trace=self._trace,
            path=self._targets,
            ghost=self._ghost,
            steps=self._steps,
            cursor=self.cursor,
            observation=self._observation,
            arms=self._arms,
            actions=() if motors is None else (motors.commanded[0], motors.sent[0]),
        )
        return self._renderer.draw(scene)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}  # windows belong to a process

    def _begin(self, setup: ReachSetup, episode: Episode) -> None:
        """Let an episode be the present one, and empty the buffers of late observations."""
        if self.setup is not setup or episode.body != self._arm.parameters:
            self.close()  # the window shows one arm
        self.setup, self.episode, self._numbers = setup, episode, episode.numbers
        self._shown, self._context = setup.context_of(episode.numbers[None])[0], self.context
        self._has_context = setup.episodes.is_drawn or len(self._shown) > 0
        locks = max(episode.lock_step, episode.unlock_step) > 0
        self._has_events = setup.trials.path_length > 1 or locks or setup.is_timed
        self._has_events |= setup.are_senses_disturbed or setup.are_motors_disturbed
        self._noise, self._motors, self._senses = setup.links(1, episode.delays)
        self._observation: Any = None  # without its context, if senses are disturbed

    def _with_context(self, observation: Any, info: Info) -> Any:
        """Write the drawn context into `info`; return the observation with the observed context."""
        if self._context:
            info["context"] = self._context.copy()
        return with_context(observation, self._shown) if len(self._shown) else observation

    def _place(self, posture: list[float], targets: list[Point]) -> None:
        setup, episode = self.setup, self.episode
        self._arm.reset(posture, parameters=episode.body)
        self._arms, self.cursor = episode.arms, episode.cursor  # at the present time
        self._spans = setup.episodes.spans(episode.numbers)
        if setup.is_timed:
            self._change(0)
        self._noise.begin(_FIRST, episode.arms)
        if self._motors is not None:
            self._motors.begin(_FIRST, setup.rest(np.array([self._arm.joint_angles])))
        self._speeds = [0.0] * len(posture)
        self._steps = self._place_on_path = 0
        self._targets, self._target = targets, targets[0]
        self._is_last_target = setup.task.advance == "time" or len(targets) == 1
        if episode.lock_step == 0:
            self._arm.lock()
        if setup.channel is not None:
            self._arm.confine(self._arm.end_effector, self._target)
        self._trace.clear()
        self._trace.append(self._arm.end_effector)

    def _change(self, steps: int) -> None:
        """Let the perturbations be what they are after so many control steps."""
        self._arms = arms = self.setup.episodes.arms(self._numbers[None], np.array([steps]))
        touched = self.setup.episodes.touched
        if self.setup.has_cursor:
            self.cursor = Cursor.of(arms, touched).row(0)
        if self.setup.is_loaded:
            self._arm.load(arms.parameters(touched))

    def _command(self, action: ArrayLike) -> list[float]:
        if type(action) is not np.ndarray or action.dtype.kind != "f":
            action = require_array("action", action, "numbers within -1 and 1")
        if action.shape != self._action_shape:
            raise UserError(f"action must have shape {self._action_shape}, got {action.shape}")
        values, scale = action.tolist(), self.setup.action.scale
        for value in values:
            if not -1.0 <= value <= 1.0:  # true for NaN too
                raise UserError(f"action must lie within -1 and 1, got {values}")
        if self._motors is not None:
            steps = np.array([self._steps])
            values = self._motors.send([values], self._arms, self._noise, steps)[0].tolist()
        return [scale * value for value in values]

    def _advance_events(self) -> None:
        """Move the target along its path and lock joints, after a step."""
        self._steps += 1
        if any(first <= self._steps <= last for first, last in self._spans):
            self._change(self._steps)
        if self._steps == self.episode.lock_step:
            self._arm.lock()
        if self._steps == self.episode.unlock_step:
            self._arm.unlock()
        task, last = self.setup.task, len(self._targets) - 1
        if task.advance == "time":
            place = self._steps % (last + 1) if task.periodic else min(self._steps, last)
        else:
            reached = _distance(self._seen_hand(), self._target) <= self.success_distance
            self._place_on_path = place = min(self._place_on_path + reached, last)
            self._is_last_target = place == last
        self._target = self._targets[place]

    def _look_and_reward(self) -> tuple[Any, float, Info]:
        """Return observation, reward and info of the present state; store its joint speeds."""
        arm, setup, target = self._arm, self.setup, self._target
        cursor = self.cursor
        hand = arm.end_effector if cursor is None else self._seen_hand()
        speeds = relative_speeds(arm.joint_velocities, setup.given_body.speed_limit)
        distance = _distance(hand, target)
        is_success = distance <= setup.success_distance and self._is_last_target
        reward, info = reward_and_info(distance, is_success, speeds, self._speeds, setup.reward)
        self._speeds = speeds
        info["end_effector"] = np.array(arm.end_effector)
        info["target"] = np.array(target)
        if cursor is not None:
            info["cursor"] = np.array(hand)
        if setup.channel is not None:
            force, speed = arm.contact
            info["channel_force"] = np.float64(force)
            info["ideal_force"] = np.float64(setup.channel * speed)
        if self._noise.is_drawn:
            self._noise.draw(_FIRST, np.array([self._steps]), [self.np_random])
        if self._motors is not None:
            info["action_sent"] = self._motors.sent[0].copy()
        if self._senses is None:
            seen = setup.layout.encode(arm.joint_angles, speeds, hand=hand, target=target)
            return seen, reward, info
        return self._sense(speeds, hand, info), reward, info

    def _sense(self, speeds: list[float], hand: Point, info: Info) -> NDArray[np.float32]:
        """Return what is observed by disturbed senses; complete `info`."""
        arm, setup, steps, senses = self._arm, self.setup, np.array([self._steps]), self._senses
        assert senses is not None
        if senses.change_state:
            state = arm.joint_angles, self._target, arm.joint_velocities, hand
            true = Seen(*(np.array([part]) for part in state))
            hands = info["end_effector"][None]
            seen, is_seen = senses.sense(_FIRST, steps, true, self._arms, self._noise, hands)
            if is_seen is not None:
                info["is_hand_seen"] = np.array(is_seen[0])
            observation = setup.observe(seen)
        else:
            angles, target = arm.joint_angles, self._target
            observation = setup.layout.encode(angles, speeds, hand=hand, target=target)[None]
        observation = senses.transmit(_FIRST, steps, observation, self._arms, self._noise)
        self._observation = observation[0]
        return self._observation.copy()

    def _seen_hand(self) -> Point:
        """Return the position of the hand, or of the cursor that stands for it."""
        cursor, hand = self.cursor, self._arm.end_effector
        return hand if cursor is None else cursor.at(*hand, self._target)


def with_context(observation: Any, shown: NDArray[np.float32]) -> Any:
    """Return observations, (..., n) or a mapping, with a context, (..., m), appended."""
    if isinstance(observation, dict):
        return {**observation, "observation": with_context(observation["observation"], shown)}
    return np.concatenate([observation, shown], axis=-1)


def _distance(hand: Point, target: Point) -> float:
    # The operations of `distances`, so that relabelling gives the same bits.
    x, y = target[0] - hand[0], target[1] - hand[1]
    return math.sqrt(x * x + y * y)


class GoalEnvironment(ReachEnvironment):
    """The common part of the goal environments: rewards for relabelled transitions."""

    def compute_reward(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """Return the reward for hands (..., 2) and targets (..., 2), shape (...)."""
        del info
        hands, targets = (np.asarray(goal, np.float64) for goal in (achieved_goal, desired_goal))
        setup, distance = self.setup, distances(hands, targets)
        if setup.reward.is_sparse:
            return (distance <= setup.success_distance) - 1.0
        return -distance + precision(distance, setup.reward.precision_weight)

    def compute_terminated(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """Return whether transitions end an episode, shape (...); see `terminate_on_success`."""
        del info
        hands, targets = (np.asarray(goal, np.float64) for goal in (achieved_goal, desired_goal))
        is_reached = distances(hands, targets) <= self.setup.success_distance
        return self.setup.terminates & is_reached

    def compute_truncated(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """Return False for every transition, shape (...): only the time limit truncates."""
        del desired_goal, info
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]


class MMCReachGoalEnv(GoalEnvironment, MMCReachEnv):
    """`MMCReachEnv` as a goal environment, for hindsight experience replay.

    It differs from `MMCReach-v0` in:

    ## Observation Space
    `Dict`: `observation`, `Box(-1, 1, (9,), float32)` (cos and sin of the joint angles, joint
    velocities / 2π rad/s), `achieved_goal` (hand) and `desired_goal` (target), both
    `Box(-reach, reach, (2,), float64)` in segment lengths.

    ## Rewards
    Sparse by default.  There is no control cost: the reward is `compute_reward` of the two
    goals alone, so that replayed transitions can be relabelled.

    ## Arguments
    Those of `MMCReachEnv` without `control_weight` and `smoothness_weight`.

    ## Version History
    * v0: initial version
    """

    @takes(SingleGoalArguments)
    def __init__(self, arguments: SingleGoalArguments) -> None:
        self._make(GoalSetup, arguments)
