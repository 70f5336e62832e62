"""Play `PandaReachJoints-v3` with the given body and with changed ones: agents, IK, TQC.

All agents are given the standard model of the Panda.  In most rows the true arm differs: a link is
longer, or a joint is locked; or a motor or a sensor fails (`--faults`): a motor gets 40 % of its
action, a motor is pushed by 0.2 of the largest action, a joint is felt where it was at first.
Episodes end when the hand is within 5 cm of the target, or after 50 steps; every step without costs
1 (the return).  A hand that rests for 10 steps is taken to stay.  With `--stays` they all last 50
steps, and the hand should be within 1 cm of the target at the end.
"Within reach" is the share of the targets to which some posture of the true body brings the hand,
by the network from 100 postures.

    python -m studies.other_bodies.panda
    python -m studies.other_bodies.panda --seed 1
    python -m studies.other_bodies.panda --agents     # only prints the results
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import tyro
from rich.console import Console

from examples.panda_reach import BASE, TURN, Encoders, PandaReach
from mmc_gym import make_agent
from mmc_gym.agents.body_model.agent import ik_body
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.robots import HingeArm, HingeNetwork
from studies.other_bodies.actors import FOLDER, Actor
from studies.other_bodies.faults import NO_FAULT, Fault, Faulty
from studies.other_bodies.panda_bodies import NEUTRAL, changed_urdf, make_env
from studies.tables import table_of

INTERFACE = PandaReach()
NEAR = 0.01  # metres, from the target, of a hand that stays
BODIES: dict[str, dict[str, Any]] = {
    "given": {},
    "base 20 % longer": {"longer": {"panda_joint1": 1.2}},
    "upper arm 20 % longer": {"longer": {"panda_joint3": 1.2}},
    "forearm 20 % longer": {"longer": {"panda_joint5": 1.2}},
    **{f"joint {joint} locked": {"locked": (joint - 1,)} for joint in range(1, 7)},
}
UNTUNED: dict[str, dict[str, Any]] = {
    "forearm 40 % longer": {"longer": {"panda_joint5": 1.4}},
    "upper arm and forearm 15 % longer": {"longer": {"panda_joint3": 1.15, "panda_joint5": 1.15}},
    "a tool of 10 cm": {"longer": {"panda_grasptarget_hand": 1 + 0.1 / 0.105}},
    "forearm 20 % longer, joint 6 locked": {"longer": {"panda_joint5": 1.2}, "locked": (5,)},
}
FAULTS: dict[str, dict[str, Any]] = {
    "motor 2 at 40 %": {"fault": Fault(weak=1)},
    "motor 4 at 40 %": {"fault": Fault(weak=3)},
    "motor 2 pushed": {"fault": Fault(pushed=1)},
    "motor 4 pushed": {"fault": Fault(pushed=3)},
    "sensor 2 stuck": {"fault": Fault(stuck=1)},
    "sensor 4 stuck": {"fault": Fault(stuck=3)},
    "a tool of 10 cm": UNTUNED["a tool of 10 cm"],
}
ALL_BODIES = {**BODIES, **UNTUNED, **FAULTS}
AGENTS = ("mmc-body", "ik-body", "least squares", "pybullet", "tqc")
STEPS, STUCK = 50, 10  # of an episode; steps after which a hand that rests is taken as stuck


@dataclass(frozen=True)
class Arguments:
    """Play what is not in the folder yet, then print all results of the seed."""

    # who plays: the two agents; damped least squares alone, without their loops; pybullet's inverse
    # kinematics; TQC.  Without any, the results are printed.
    agents: tuple[str, ...] = AGENTS
    # the bodies of the tables, or those on which nothing was tuned
    bodies: tuple[str, ...] = tuple(BODIES)
    faults: bool = False  # play motors and sensors that fail, and a tool, instead of `bodies`
    stays: bool = False  # whether the hand should stay, within 1 cm of the target
    episodes: int = 500  # episodes of each agent with each body
    seed: int = 0  # 0 plays the environment's seeds 0, 1, …; 1 those from 1000 on
    tqc: Path = FOLDER / "tqc_50000.safetensors"  # actor of TQC; `trainings` makes others
    out: Path = Path("runs/panda")  # folder for the results


class PybulletAgent:
    """Turns to the posture of pybullet's inverse kinematics, with the hand pointing down.

    It is asked in each step from the present posture, with the body as given.
    """

    def __init__(self) -> None:
        self.robot = make_env().unwrapped.robot

    def predict(self, observation: Any, state: Any = None, **_: Any) -> tuple[Any, None]:
        """Return the action."""
        now = observation["joints"][0]
        self.robot.set_joint_angles([*now, 0.0, 0.0])
        goal = self.robot.inverse_kinematics(
            self.robot.ee_link, observation["desired_goal"], np.array([1.0, 0.0, 0.0, 0.0])
        )
        return np.clip((goal[:7] - now) / TURN, -1.0, 1.0).astype(np.float32), None


def make_body(fault: Fault = NO_FAULT, **body: Any) -> gym.Env[Any, Any]:
    """Make the environment of a body, see `make_env`, of which something fails."""
    joint = fault.stuck
    return Faulty(Encoders(make_env(**body)), fault, (0, joint), (1, joint), "joints")


def make(name: str, env: Any, tqc: Path, interface: PandaReach = INTERFACE) -> Any:
    """Make an agent for an environment."""
    alone = Parts(identifies_body=False, finds_motors=False, finds_locks=False, imagines=False)
    makers: dict[str, Callable[[], Any]] = {
        "least squares": lambda: ik_body(interface, alone),
        "pybullet": PybulletAgent,
        "tqc": lambda: Actor(tqc),
    }
    if name in makers:
        return makers[name]()
    return make_agent(name, env, interface=interface)


def play(agent: Any, env: Any, seeds: range, stays: bool = False) -> tuple[float, float, float]:
    """Return success, mean return, and half of its 95 % interval, of an agent.

    If it `stays`, episodes go on after the hand has come to its target.
    """
    returns, successes = [], []
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        state, total, places, steps, ended = None, 0.0, [], 0, False
        while not ended:
            action, state = agent.predict(observation, state)
            observation, reward, terminated, truncated, info = env.step(action)
            total, steps = total + reward, steps + 1
            ended = truncated or (terminated and not stays)
            places = [*places[-STUCK + 1 :], observation["achieved_goal"]]
            if not stays and len(places) == STUCK and np.ptp(places, axis=0).max() < 1e-4:
                total -= STEPS - steps  # it would stay there
                break
        returns.append(total)
        successes.append(info["is_success"])
    half = 1.96 * np.std(returns, ddof=1) / len(returns) ** 0.5
    return float(np.mean(successes)), float(np.mean(returns)), float(half)


def within_reach(body: dict[str, Any], env: Any, seeds: range, within: float) -> float:
    """Return the share of targets that the true body reaches."""
    with TemporaryDirectory() as folder:
        urdf = changed_urdf(body.get("longer", {}), Path(folder))
        arm = HingeArm.from_urdf(urdf, base="panda_link0", tip="panda_grasptarget")
    targets = [env.reset(seed=seed)[0]["desired_goal"] - BASE for seed in seeds]
    held = {joint: NEUTRAL[joint] for joint in body.get("locked", ())}
    network = HingeNetwork(replace(arm, limits=INTERFACE.arm.limits))
    start = np.clip(NEUTRAL, *INTERFACE.arm.limits.T)
    starts = np.broadcast_to(start, (len(targets), 7))
    solution = network.solve(np.array(targets), start=starts, held=held, starts=100)
    return float((solution.position_error < within).mean())


def main(arguments: Arguments) -> None:
    """Play, and print the table."""
    interface = PandaReach(NEAR) if arguments.stays else INTERFACE
    within = interface.success_distance
    seeds = range(1000 * arguments.seed, 1000 * arguments.seed + arguments.episodes)
    stays = "-stays" if arguments.stays else ""
    file = arguments.out / f"{arguments.episodes}-{arguments.seed}{stays}.csv"
    rows = pd.read_csv(file).to_dict("records") if file.exists() else []
    for body in FAULTS if arguments.faults else arguments.bodies:
        with closing(make_body(**ALL_BODIES[body], within=within)) as env:
            for agent in ("within reach", *arguments.agents) if arguments.agents else ():
                if any(row["body"] == body and row["agent"] == agent for row in rows):
                    continue
                if agent == "within reach":
                    share = within_reach(ALL_BODIES[body], env, seeds, within)
                    scores = share, 0.0, 0.0
                else:
                    player = make(agent, env, arguments.tqc, interface)
                    scores = play(player, env, seeds, arguments.stays)
                names = ("success", "return", "half")
                rows.append({"body": body, "agent": agent, **dict(zip(names, scores))})
                print(rows[-1], flush=True)
                arguments.out.mkdir(parents=True, exist_ok=True)
                pd.DataFrame(rows).to_csv(file, index=False, lineterminator="\n")
    known = {(row["body"], row["agent"]): row for row in rows}
    cells = [
        {"body": body, "within reach": f"{100 * known[body, 'within reach']['success']:.1f}"}
        | {agent: cell(known.get((body, agent))) for agent in AGENTS}
        for body in ALL_BODIES
        if (body, "within reach") in known
    ]
    Console(width=170).print(table_of(cells, "success in per cent, return"))


def cell(row: Any) -> str:
    """Return success in per cent, and mean return with its 95 % interval."""
    if row is None:
        return ""
    return f"{100 * row['success']:.1f}, {row['return']:.2f} ± {row['half']:.2f}"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
