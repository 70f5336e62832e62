"""Play `Reacher-v5` with the given body and with changed ones: agents, plain IK, SAC.

All agents are given the arm of the package.  In most rows the true arm differs: a link is longer,
or friction holds a joint where it starts; or a motor or a sensor fails (`--faults`): a motor gets
40 % of its torque, a motor is pushed by 0.2 of the largest torque, a joint is felt where it was at
first.  The return is the environment's: minus the distance in metres and the squared torques,
summed over 50 steps.  An episode succeeds if at its end the hand is within 1 cm of the target; or
of the nearest point that the true arm can reach, because with a joint held an arm of two joints
reaches only a circle.

    python -m studies.other_bodies.reacher
    python -m studies.other_bodies.reacher --seed 1
    python -m studies.other_bodies.reacher --agents     # only prints the results

The agents: `mmc-body` and `ik-body` through the interface of `examples/reacher.py`; "ik": inverse
kinematics in closed form of the given arm, with the same servo; "ik, pd": the same with a servo of
two constants, tuned by hand; SAC after so many steps; "optimum": for each episode the
torques that a search finds which knows the arm, the target and the cost (the arm as given only).
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import minimize

from examples.reacher import GEAR, INTERFACE, ReacherInterface
from mmc_gym import make_agent
from mmc_gym.agents.base import JointTargetAgent
from mmc_gym.agents.inverse_kinematics import leave_line
from mmc_gym.geometry import nearest_reachable, wrap_angle
from mmc_gym.measures import episode_seeds
from studies.other_bodies.actors import FOLDER, Actor
from studies.other_bodies.faults import NO_FAULT, Fault, Faulty
from studies.tables import table_of

Floats = NDArray[np.float64]

LENGTHS = (0.1, 0.11)  # metres
ELBOW = 3.0  # the elbow's limit, radians
NEAR = 0.01  # metres
STEPS, STEP = 50, 0.02
LONGER = (0.12, 0.132)  # lengths of links that are a fifth longer
LINKS = ('name="body1" pos="{} 0 0"', 'name="fingertip" pos="{} 0 0"')  # in the model's file


@dataclass(frozen=True)
class TrueBody:
    """What is changed: the link that is a fifth longer, the joint that is held, and more."""

    longer: int | None = None
    held: int | None = None
    tool: float = 0.0  # what the second link is longer by, metres
    fault: Fault = NO_FAULT

    @property
    def lengths(self) -> Floats:
        """Lengths of the links, metres."""
        links = np.array([LONGER[j] if j == self.longer else LENGTHS[j] for j in (0, 1)])
        return links + np.array([0.0, self.tool])

    def make(self, folder: Path) -> gym.Env[Any, Any]:
        """Make the environment; the model's file is written into `folder`."""
        env = gym.make("Reacher-v5", disable_env_checker=True)
        if replace(self, fault=NO_FAULT) == TrueBody():
            return self._failing(env)
        model = Path(env.unwrapped.fullpath).read_text()  # type: ignore[attr-defined]
        for link, old_length, length in zip(LINKS, LENGTHS, self.lengths, strict=True):
            assert link.format(old_length) in model
            model = model.replace(link.format(old_length), link.format(length))
        if self.held is not None:
            model, count = re.subn(rf'(name="joint{self.held}")', r'\1 frictionloss="1000"', model)
            assert count == 1
        file = folder.resolve() / f"reacher-{self.longer}-{self.held}-{self.tool}.xml"
        file.write_text(model)
        return self._failing(gym.make("Reacher-v5", xml_file=str(file), disable_env_checker=True))

    def _failing(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        joint = self.fault.stuck or 0
        return Faulty(env, self.fault, angles=[joint, 2 + joint], speeds=6 + joint)

    def nearest(self, starts: Floats, targets: Floats) -> Floats:
        """Return the least distance to targets (n, 2) that hands can reach from `starts`, (n,)."""
        postures = np.meshgrid(np.linspace(-np.pi, np.pi, 2001), np.linspace(-ELBOW, ELBOW, 2001))
        if self.held is None:  # only the distance from the base matters
            reached = np.abs(self._hand(0.0, postures[1][:, 0]))
            distance = np.linalg.norm(targets, axis=-1)
            return np.abs(distance - np.clip(distance, reached.min(), reached.max()))
        free = [postures[0][0], postures[1][:, 0]]
        free[self.held] = starts[:, self.held, None]
        return np.abs(self._hand(*free) - targets @ np.array([[1.0], [1j]])).min(axis=-1)

    def _hand(self, first: Any, second: Any) -> Any:
        upper, lower = self.lengths
        return upper * np.exp(1j * first) + lower * np.exp(1j * (first + second))


BODIES = {
    "as given": TrueBody(),
    "first link 20 % longer": TrueBody(longer=0),
    "second link 20 % longer": TrueBody(longer=1),
    "first joint held": TrueBody(held=0),
    "second joint held": TrueBody(held=1),
}
FAULTS = {
    **{f"motor {joint} at 40 %": TrueBody(fault=Fault(weak=joint - 1)) for joint in (1, 2)},
    **{f"motor {joint} pushed": TrueBody(fault=Fault(pushed=joint - 1)) for joint in (1, 2)},
    **{f"sensor {joint} stuck": TrueBody(fault=Fault(stuck=joint - 1)) for joint in (1, 2)},
    "a tool of 5 cm": TrueBody(tool=0.05),
}
AGENTS = ("mmc-body", "ik-body", "ik", "ik, pd", "sac 100k", "sac 500k", "optimum")


@dataclass(frozen=True)
class Arguments:
    """Play what is not in the folder yet, then print all results of the seed."""

    # who plays; without any, the results in the folder are printed
    agents: tuple[str, ...] = AGENTS
    bodies: tuple[str, ...] = tuple(BODIES)  # the bodies
    faults: bool = False  # play motors and sensors that fail, and a tool, instead of `bodies`
    episodes: int = 1000  # episodes of each agent with each body, those of `mmc-gym compare`
    seed: int = 0  # of the starts and targets
    late: int = 0  # control steps of 20 ms by which all senses are late
    sac: Path = FOLDER  # folder with the actors of SAC; `trainings` makes others
    out: Path = Path("runs/reacher")  # folder for the results


class ClosedForm(JointTargetAgent[Floats]):
    """Inverse kinematics in closed form of two links, by the solution nearest to the last one.

    |w| is the target's distance.  Of two solutions, the one that the joint limits allow is taken.

        tan²(q₂/2) = ((ℓ₁ + ℓ₂)² − |w|²) / (|w|² − (ℓ₁ − ℓ₂)²)
        q₁ = ∠w − ∠(ℓ₁ + ℓ₂ cos q₂, ℓ₂ sin q₂)
    """

    def start(self, sensed: Any) -> Floats:
        """Begin with the sensed posture."""
        return sensed.joint_angles  # type: ignore[no-any-return]

    def advance(self, state: Floats, sensed: Any) -> tuple[Floats, Floats]:
        """Return the joint targets (..., 2), twice."""
        lengths = self.interface.segment_lengths
        first, second = lengths
        target = nearest_reachable(sensed.target, lengths)
        distance = np.hypot(target[..., 0], target[..., 1])
        short = (first + second - distance) * (first + second + distance)
        long = (distance - abs(first - second)) * (distance + abs(first - second))
        elbow = 2 * np.arctan2(np.sqrt(np.maximum(short, 0.0)), np.sqrt(np.maximum(long, 0.0)))
        bearing = np.arctan2(target[..., 1], target[..., 0])
        offset = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
        ways = (bearing - offset, elbow), (bearing + offset, -elbow)
        solutions = np.stack([np.stack(way, axis=-1) for way in ways], axis=-2)
        low, high = np.transpose(self.interface.joint_limits)
        within = (low + high) / 2 + wrap_angle(solutions - (low + high) / 2)
        allowed = np.clip(within, low, high)
        changes = allowed - leave_line(state, target, lengths)[..., None, :]
        beyond = np.abs(within - allowed).max(axis=-1) > 1e-9
        nearest = ((changes**2).sum(axis=-1) + 1e3 * beyond).argmin(axis=-1)
        joint_targets = np.take_along_axis(allowed, nearest[..., None, None], axis=-2)[..., 0, :]
        return joint_targets, joint_targets


class Late(gym.ObservationWrapper[Any, Any, Any]):
    """What was seen some control steps ago; at first the start."""

    def __init__(self, env: gym.Env[Any, Any], steps: int) -> None:
        super().__init__(env)
        self.seen: deque[Any] = deque(maxlen=steps + 1)

    def reset(self, **arguments: Any) -> Any:
        """Forget the episode before."""
        self.seen.clear()
        return super().reset(**arguments)

    def observation(self, observation: Any) -> Any:
        """Return what is seen."""
        self.seen.append(observation)
        return self.seen[0]


class TwoConstants(ReacherInterface):
    """A servo of two constants, tuned by hand: torque = 0.3 x - 0.05 q'."""

    def act(self, joint_targets: Floats, sensed: Any) -> NDArray[np.float32]:
        """Return the torques."""
        left = self.turn(sensed.joint_angles, joint_targets)
        return np.clip(0.3 * left - 0.05 * sensed.joint_speeds, -1, 1).astype(np.float32)


def make(name: str, env: Any, sac: Path) -> Any:
    """Make an agent for an environment."""
    if name == "optimum":
        return None
    if name.startswith("sac"):
        return Actor(sac / f"sac_{name[4:].replace('k', '000')}.safetensors")
    if name == "ik, pd":
        settings = {field.name: getattr(INTERFACE, field.name) for field in fields(INTERFACE)}
        return ClosedForm(TwoConstants(**settings))
    return ClosedForm(INTERFACE) if name == "ik" else make_agent(name, env, interface=INTERFACE)


def play(agent: Any, envs: list[Any], seeds: list[int]) -> pd.DataFrame:
    """Return return, start and end of an episode of each seed; all are played side by side."""
    seen = np.stack([env.reset(seed=seed)[0] for env, seed in zip(envs, seeds, strict=True)])
    start, target = np.arctan2(seen[:, 2:4], seen[:, :2]), seen[:, 4:6]
    if agent is None:
        tasks = zip(start, seen[:, 6:8], target)
        plans = np.stack([optimal_torques(*task) for task in tasks])
    returns, state = np.zeros(len(envs)), None
    for number in range(STEPS):
        if agent is None:
            actions = plans[:, number]
        else:
            actions, state = agent.predict(seen, state, deterministic=True)
        steps = [env.step(action) for env, action in zip(envs, actions, strict=True)]
        seen = np.stack([observation for observation, *_ in steps])
        returns += [reward for _, reward, *_ in steps]
    hands = np.array([env.unwrapped.get_body_com("fingertip")[:2] for env in envs])
    columns = {"return": returns, "distance": np.linalg.norm(hands - target, axis=-1)}
    columns |= dict(zip(("start_1", "start_2"), start.T))
    return pd.DataFrame({**columns, **dict(zip(("target_x", "target_y"), target.T))})


def optimal_torques(start: Floats, speeds: Floats, target: Floats) -> Floats:
    """Return the torques (50, 2) of the least cost that a search finds; the joints are linear."""
    times = STEP * np.arange(1, STEPS + 1)
    coasting = start + np.outer(1 - np.exp(-times), speeds)
    later = np.subtract.outer(times, times - STEP)  # from the begin of a torque to each time
    begin, end = np.exp(-np.abs(later)), np.exp(-np.abs(later - STEP))
    effect = np.where(later > STEP / 2, GEAR * (STEP - end + begin), 0.0)

    def cost(flat: Floats) -> tuple[float, Floats]:
        torques = flat.reshape(STEPS, 2)
        angles = coasting + effect @ torques
        lower = LENGTHS[1] * np.exp(1j * angles.sum(axis=-1))
        hand = LENGTHS[0] * np.exp(1j * angles[:, 0]) + lower
        error = hand - complex(*target)
        distance = np.sqrt(np.abs(error) ** 2 + 1e-8)
        pull = np.stack([(1j * x * error.conj()).real for x in (hand, lower)], -1)
        pull /= distance[:, None]
        beyond = np.abs(angles[:, 1]) - (ELBOW - 0.02)
        beyond = np.maximum(beyond, 0.0) * np.sign(angles[:, 1])
        pull[:, 1] += 400 * beyond
        total = distance.sum() + (torques**2).sum() + 200 * (beyond**2).sum()
        return float(total), (effect.T @ pull + 2 * torques).ravel()

    solutions = []
    upper, lower = LENGTHS
    cosine = (target @ target - upper**2 - lower**2) / (2 * upper * lower)
    bend = np.arccos(np.clip(cosine, np.cos(ELBOW - 0.02), 1))
    for elbow in (bend, -bend):
        shoulder = np.angle(complex(*target)) - np.angle(upper + lower * np.exp(1j * elbow))
        shoulder = (shoulder - start[0] + np.pi) % (2 * np.pi) - np.pi + start[0]
        for turns in (-1, 0, 1):
            goal = np.array([shoulder + 2 * np.pi * turns, elbow])
            push = np.where(np.arange(20) < 10, 1.0, -1.0)  # off, then to rest
            first = np.zeros((STEPS, 2))
            first[:20] = np.outer(push, 4 * (goal - start) / (GEAR * 0.4**2))
            if np.abs(goal[0] - start[0]) < 4:
                options = {"maxiter": 800}
                bounds = [(-1, 1)] * (2 * STEPS)
                solutions.append(
                    minimize(cost, first.ravel(), jac=True, bounds=bounds, options=options)
                )
    return min(solutions, key=lambda solution: solution.fun).x.reshape(STEPS, 2).astype(np.float32)


def main(arguments: Arguments) -> None:
    """Play what is missing, and print the table."""
    seeds = episode_seeds(arguments.seed, arguments.episodes)
    arguments.out.mkdir(parents=True, exist_ok=True)
    asked_bodies = FAULTS if arguments.faults else arguments.bodies
    cells: dict[str, dict[str, str]] = {body: {"body": body} for body in asked_bodies}
    for body, true in {**BODIES, **FAULTS}.items():
        envs: list[Any] = []
        for name in AGENTS:
            late = f"-late-{arguments.late}" if arguments.late else ""
            file = arguments.out / f"{name}-{body}-{arguments.seed}{late}.csv".replace(" ", "-")
            asked = name in arguments.agents and body in asked_bodies
            if asked and not file.exists() and (name != "optimum" or true == TrueBody()):
                envs = envs or [Late(true.make(arguments.out), arguments.late) for _ in seeds]
                episodes = play(make(name, envs[0], arguments.sac), envs, seeds)
                episodes.to_csv(file, index=False, lineterminator="\n")
            if file.exists():
                row = cells.setdefault(body, {"body": body})
                row[name] = cell(pd.read_csv(file), true)
        for env in envs:
            env.close()
    players = [name for name in AGENTS if any(name in row for row in cells.values())]
    rows = [{"body": "", **dict.fromkeys(players, ""), **row} for row in cells.values()]
    title = f"{arguments.episodes} episodes of seed {arguments.seed}: success in per cent, return"
    Console(width=170).print(table_of(rows, title))


def cell(episodes: pd.DataFrame, true: TrueBody) -> str:
    """Return success in per cent, and mean return with its 95 % interval."""
    starts, targets = (
        episodes[list(names)].to_numpy()
        for names in (("start_1", "start_2"), ("target_x", "target_y"))
    )
    missed = episodes["distance"].to_numpy() - true.nearest(starts, targets)
    half = 1.96 * episodes["return"].std() / len(episodes) ** 0.5
    return f"{100 * (missed <= NEAR).mean():.1f}, {episodes['return'].mean():.2f} ± {half:.2f}"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
