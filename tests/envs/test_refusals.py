"""What no environment, perturbation or task can be is refused by the name of the argument."""

import math

import gymnasium as gym
import pytest
from scipy.stats import uniform

import mmc_gym
from mmc_gym import UserError
from mmc_gym.envs.perturbations import (
    JointNoise,
    LockedJoint,
    Obstacles,
    SegmentLength,
    SensoryDelay,
    VisuomotorRotation,
)
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import parse_environment, parse_scenario
from mmc_gym.envs.tasks import DoubleStep, PointToPoint, Pursuit, RandomTarget, Trial, ViaPoints
from mmc_gym.envs.vector import MMCReachVectorEnv

REACH = gym.make("MMCReach-v0")
MISSPELT = type("Misspelt", (RandomTarget,), {"drawn": RandomTarget.draw})()


def reach(*perturbations, **arguments):
    return MMCReachEnv(perturbations=perturbations, **arguments)


def assert_refused(call, message):
    with pytest.raises(UserError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: reach(control="torque"), "control 'torque' .*; did you mean 'joint_torque'"),
        (lambda: reach(reward_type="golden"), "reward_type 'golden'"),
        (lambda: reach(render_mode="ansi"), "render_mode 'ansi'"),
        (lambda: reach(width=0), "width must be a whole number of at least 1, got 0"),
        (lambda: reach(control_weight="a"), "control_weight must be from 0"),
        (lambda: reach(n_segments=4), "unexpected keyword argument 'n_segments'"),
        (lambda: MMCReachGoalEnv(control_weight=0.1), "control_weight must be 0"),
        (lambda: MMCReachGoalEnv(smoothness_weight=0.1), "smoothness_weight must be 0"),
        (lambda: MMCReachGoalEnv(perturbations="joint-noise"), "no disturbed senses and no via"),
        (lambda: MMCReachGoalEnv(task="via-points"), "no disturbed senses and no via"),
        *(
            (lambda name=name: MMCReachVectorEnv(**{"num_envs": 2, name: 0}), name)
            for name in ("num_envs", "max_episode_steps", "autoreset_mode", "render_mode", "thread")
        ),
        (lambda: parse_environment(REACH).make(), "env must be an id"),
        (lambda: parse_environment(None).make(), "env must be an id"),
    ],
)
def test_an_environment_that_cannot_be_is_refused(call, message):
    assert_refused(call, message)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: MMCReachEnv(perturbations="rotation-30+delay-40"),
            r"perturbations '.* a list such as \['rotation-30', 'delay-40'",
        ),
        (lambda: MMCReachEnv(perturbations=None), "None is not accepted. .* or a Change$"),
        (lambda: reach(Obstacles(((0.0, 0.0, 1.0),))), "obstacles must leave room for the arm"),
        (lambda: reach(VisuomotorRotation(180, centre=(20, 0))), "must leave targets in reach"),
        (lambda: reach("longer-500"), "must leave targets in reach"),
        (lambda: reach(SegmentLength(segment=3)), "segment must be a whole number from 1 to 3"),
        (lambda: reach(LockedJoint(0), LockedJoint(1, time=0.2)), "must lock at one time"),
        (lambda: SegmentLength(0.0), "strength of longer must be at least -99.9999, got -100"),
        (lambda: reach(LockedJoint(1, time=-0.1)), "at must be from 0 to 1000"),
        (lambda: SensoryDelay(math.inf), "strength must be a finite number, got inf"),
        (lambda: JointNoise(math.nan), "strength of joint-noise must be from 0 to 1e.09, got nan"),
        (
            lambda: reach(VisuomotorRotation(1.0, centre=(0, math.inf))),
            "centre must be two fin",
        ),
        (lambda: VisuomotorRotation(30.0, center=(0, 1)), "unexpected keyword argument 'center'"),
        # Of what is drawn.
        (lambda: reach("longer--150..20"), "longer must be at least -99.9999, got -150"),
        (lambda: reach("rotation-60..-60"), "from a low to a strength that is not lower"),
        (lambda: reach("locked-1..5"), "joint or segment must be a whole number from 1 to 3"),
        (lambda: reach("longer-0..30-known"), "agents are given their arm once"),
        (lambda: SegmentLength(uniform(-0.2, 1)), "strength of longer must be at least -99.9999"),
        (
            lambda: SegmentLength(uniform(1, 1), known=True),
            "known of longer must be False for what",
        ),
        (lambda: reach("force-field-0..500"), "perturbations must be possible whatever is drawn"),
        (lambda: reach(observe_context="rotation-30"), "observe_context must be True, or pertur"),
        (lambda: reach("rotation-0..0", observe_context=True), r"a width.*got .*rotation-0\.\.0"),
        # Of what no file can hold.
        *(
            (lambda value=value: gym.make("MMCReach-v0", perturbations=value), "from a file|Change")
            for value in (
                *({}, {"degrees": 3.0}, {"name": "os"}, {"name": "expect", "args": []}),
                *({"name": ["a"]}, {"name": "uniform", "args": ["a"]}),
                {"name": "HandMass", "mass": {"name": "norm"}},
            )
        ),
    ],
)
def test_a_perturbation_that_cannot_be_is_refused(call, message):
    assert_refused(call, message)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: reach(task="paper", segment_lengths=(2.0, 0.5)), "no evenly bent posture"),
        # The cursor leaves the reach.
        (
            lambda: reach(VisuomotorRotation(30.0, centre=(0.0, 1.5)), task="paper"),
            "where trial .* starts",
        ),
        (lambda: reach(task="paper", joint_limits=((-1, 1),) * 3), "beyond the joint limits"),
        (lambda: reach("obstacles", task="paper"), "one that the perturbed arm can do"),
        (lambda: reach("locked", task="centre-out", segment_lengths=(1, 1)), "perturbed arm"),
        (lambda: reach(task=MISSPELT), r"Misspelt must be draw\(self, request\), got 'drawn'"),
        (lambda: reach(task="centre-in"), "'centre-in' is not accepted; did you mean 'centre-out'"),
        (lambda: DoubleStep(delay=-0.1), "^delay must be"),
        (lambda: ViaPoints(count=0), "^count must be"),
        (lambda: Pursuit(multiples_x=(2.5,)), "^multiples_x must be"),
        (lambda: Pursuit(period=0.0), "^period must be"),
        (lambda: PointToPoint(points=((0,), (1,)), pairs=((0, 1),)), "^points must be"),
        (lambda: PointToPoint(pairs=((0, 1),), points=((0.5, 0.0),)), "^pairs must be"),
    ],
)
def test_a_task_that_cannot_be_is_refused(call, message):
    assert_refused(call, message)


@pytest.mark.parametrize("make", [MMCReachEnv, MMCReachVectorEnv])
@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda _: None, "what Mine.draw returns must be a Trial"),
        (lambda _: Trial([0, 0], [(1, 1)]), "joint_angles of Mine.draw must be 3 finite numbers"),
        (lambda _: Trial([0, 0, 0], (1.0, 1.0)), "targets of Mine.draw must be a path, one or mo"),
        # Only some trials are wrong.
        (lambda by: Trial([0, 0, 0], [(0, 5 * by.random.random())]), "0 to 3 from the base"),
    ],
)
def test_what_a_task_of_yours_draws_is_checked_when_the_environment_is_made(make, draw, message):
    task = type("Mine", (RandomTarget,), {"draw": lambda self, request: draw(request)})()
    with pytest.raises(UserError, match=message):
        make(task=task)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gremlins", "scenario 'gremlins' is not accepted. It may be random, .*force-field"),
        ("delay-40-known", "delay cannot be known"),
        ("rotation-30+centre-out", "'centre-out' is a task, which comes first"),
        ("locked-0", "'locked-0' is not possible: .* a whole number from 1 on, got 0"),
        ("obstacles-5", "the strength of obstacles must be a whole number from 1 to 4, got 5"),
        (f"locked-1{400 * '0'}", "a whole number from 1 on, got inf"),
        ("locks-at-1", "'locks-at-1' is not possible: .* that can begin within an ep"),
        ("mirror-over-1", "'mirror-over-1' is not possible: over must be 0"),
        ("delay-at-2000", "'delay-at-2000' is not possible: at must be"),
        ("no-feedback-3", "no-feedback takes no strength, got 3"),
        (None, "scenario None is not accepted"),
        *(
            (name, f"is not accepted; did you mean '{guess}'")
            for name, guess in {
                "rotation-3x": "rotation",  # never the word that is refused
                "rotatoin-3x": "rotation",
                "rotatoin--3": "rotation--3",
                "rotatoin-3-at-1": "rotation-3-at-1",
                "delay-": "delay",
                "Longer-35-known": "longer-35-known",
                "centreout+delay-40": "centre-out",
            }.items()
        ),
    ],
)
def test_a_name_of_no_scenario_is_refused_and_what_is_suggested_is_accepted(name, message):
    with pytest.raises(UserError, match=message):
        parse_scenario(name)
    if "did you mean" in message:
        parse_scenario(message.split("'")[1])


def test_an_arm_that_substeps_cannot_hold_together_is_refused_by_every_engine(engine):
    with pytest.raises(UserError, match="segment_masses and hand_mass must make an arm"):
        mmc_gym.make("hand-mass-1000+gravity-60", engine=engine)


@pytest.mark.parametrize(
    "arm",
    [
        {"segment_lengths": (1e-9, 1.0, 1.0)},
        {"segment_lengths": (1.0, 1.0, 1e9), "segment_masses": (1.0, 1e-9, 1e-9)},
    ],
)
def test_the_analytic_engine_refuses_joints_that_it_cannot_tell_apart(arm):
    arm = {**arm, "engine": "analytic"}
    with pytest.raises(UserError, match=r"drive_inertia must be larger .*, got 0\.0"):
        MMCReachEnv(**arm, drive_inertia=0.0)
    assert MMCReachEnv(**arm).reset(seed=0)
