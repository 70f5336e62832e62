"""Facts about motors and senses that fail, and about perturbations that end or have a number."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import randint, uniform

import mmc_gym
from mmc_gym._errors import UserError
from mmc_gym.envs.changes import Range, Walk
from mmc_gym.envs.names import as_change, as_plain, parse_change
from mmc_gym.envs.perturbations import (
    FAMILIES,
    GROUPS,
    OneOf,
    SegmentLength,
    dropped_actions,
    held_numbers,
)
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.envs.vector import MMCReachVectorEnv

PAGE = Path(__file__).resolve().parents[2] / "docs" / "concepts" / "tasks.md"

ACTIONS = np.random.default_rng(4).uniform(-1, 1, (40, 3)).astype(np.float32)
WHAT_MOTORS_DO = {
    "action-delay-40": lambda past, _: past[-3] if len(past) > 2 else np.zeros(3),
    "motor-gain--0.5": lambda past, _: -0.5 * past[-1],
    "motor-offset-0.3": lambda past, _: past[-1] + 0.3,
    "dead-zone-0.2": lambda past, _: np.where(np.abs(past[-1]) < 0.2, 0.0, past[-1]),
    "backlash-0.3": lambda past, sent: np.clip(sent, past[-1] - 0.15, past[-1] + 0.15),
    "stuck-motor-2": lambda past, sent: np.where([False, True, False], sent, past[-1]),
}


def sent_by(*perturbations, **arguments):
    """Return the actions that arrive at the servos, (40, 3)."""
    env = MMCReachEnv(perturbations=[*perturbations], **arguments)
    env.reset(seed=0)
    return np.array([env.step(action)[-1]["action_sent"] for action in ACTIONS])


def expected_of(*effects):
    """Return what arrives after effects in this order, computed with lists of past actions."""
    past, last, sent = [[] for _ in effects], np.zeros(3), []
    for action in ACTIONS.astype(float):
        for effect, inputs in zip(effects, past, strict=True):
            inputs.append(action)
            action = effect(inputs, last)
        last = np.clip(action, -1, 1)
        sent.append(last)
    return np.array(sent)


def test_effects_on_actions_follow_each_other_in_the_documented_order():
    for first, second in pairwise([*WHAT_MOTORS_DO][:-1]):  # what is stuck shows no order
        of_pair = WHAT_MOTORS_DO[first], WHAT_MOTORS_DO[second]
        sent = sent_by(second, first)  # the order of the arguments does not matter
        np.testing.assert_allclose(sent, expected_of(*of_pair), atol=1e-15)
        is_the_same = np.allclose(sent, expected_of(*reversed(of_pair)))
        # A delay and a gain act alike in any order; all other pairs do not.
        assert is_the_same == (first == "action-delay-40"), (first, second)
    everything = expected_of(*WHAT_MOTORS_DO.values())
    np.testing.assert_allclose(sent_by(*WHAT_MOTORS_DO), everything, atol=1e-15)


@pytest.mark.parametrize(
    "effects",
    [
        {
            "motor-gain-2": lambda past, _: 2 * past[-1],
            "motor-offset--0.5": lambda past, _: past[-1] - 0.5,
        },
        {
            "motor-offset-0.5": lambda past, _: past[-1] + 0.5,
            "backlash-0.3": WHAT_MOTORS_DO["backlash-0.3"],
        },
    ],
    ids="+".join,
)
def test_actions_are_clipped_after_all_effects(effects):
    np.testing.assert_allclose(sent_by(*effects), expected_of(*effects.values()), atol=1e-15)


def test_an_action_that_is_dropped_and_held_is_held():
    sent = sent_by("dropped-actions-1-at-0.2", "held-actions-1-at-0.2")
    np.testing.assert_array_equal(sent[10:], np.tile(ACTIONS[9], (30, 1)))


@pytest.mark.parametrize("family", ["dropped-actions", "held-actions", "repeated-actions"])
def test_what_is_dropped_held_or_repeated_arrives_late_and_is_pushed_then(family):
    missed = sent_by(f"{family}-0.3")
    np.testing.assert_array_equal(sent_by(f"{family}-0.3", "action-delay-40")[2:], missed[:-2])
    pushed = np.clip(missed + 0.3, -1, 1)
    np.testing.assert_allclose(sent_by(f"{family}-0.3", "motor-offset-0.3"), pushed, atol=1e-15)


def test_a_motor_has_its_gain_when_a_late_action_arrives():
    gain = sent_by("motor-gain-0.5-at-0.4") / ACTIONS
    assert {*gain.ravel().round(6)} == {0.5, 1.0}
    late = sent_by("motor-gain-0.5-at-0.4", "action-delay-40")
    np.testing.assert_allclose(late[2:], gain[2:] * ACTIONS[:-2], atol=1e-15)


def test_noise_that_grows_with_actions_grows_with_a_push():
    normal = (sent_by("action-noise-size-0.2") - ACTIONS) / np.abs(ACTIONS)
    noisy = ACTIONS + 0.3 + normal * np.abs(ACTIONS + 0.3)
    sent = sent_by("action-noise-size-0.2", "motor-offset-0.3")
    is_clear = np.abs(ACTIONS) < 0.6  # and neither was clipped
    np.testing.assert_allclose(sent[is_clear], noisy.clip(-1, 1)[is_clear], atol=1e-6)


def test_noise_of_actions_lies_between_offset_and_dead_zone():
    sent = sent_by("action-noise-0.1", "dead-zone-0.4", "motor-offset-0.2")
    asked = ACTIONS + 0.2
    is_inside = np.abs(sent) < 1
    assert not np.any((np.abs(sent) > 0) & (np.abs(sent) < 0.4))
    noise = (sent - asked)[is_inside & (sent != 0)]
    assert 0.05 < noise.std() < 0.15


def test_noise_of_actions_may_grow_with_them():
    small, large = ACTIONS * 0 + np.float32(0.05), ACTIONS * 0 + np.float32(0.5)
    spread = []
    for actions in (small, large):
        env = MMCReachEnv(perturbations="action-noise-size-0.2")
        env.reset(seed=0)
        sent = np.array([env.step(action)[-1]["action_sent"] for action in actions])
        spread.append(sent.std())
    assert spread[1] == pytest.approx(10 * spread[0])


@pytest.mark.parametrize("family", ["dropped-actions", "repeated-actions"])
def test_actions_are_dropped_or_repeated_as_often_as_said(family):
    sent, asked = sent_by(f"{family}-0.25"), ACTIONS.astype(float)
    instead = np.zeros(3) if family == "dropped-actions" else np.vstack([np.zeros(3), sent[:-1]])
    happened = np.all(np.isclose(sent, instead), axis=1) if "rep" in family else sent == 0
    assert 0.1 < happened.mean() < 0.4
    np.testing.assert_array_equal(sent[~happened], asked[~happened])


def test_a_spell_lasts_for_its_steps():
    sent = sent_by(dropped_actions(0.05, steps=5))
    for motor in (sent == 0).T:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], motor.astype(int), [0]])))
        lengths = np.diff(edges)[::2]
        assert np.all(lengths[:-1] % 5 == 0)
    with pytest.raises(UserError, match="steps must be a whole number"):
        MMCReachEnv(perturbations=held_numbers(0.1, steps=1.5))


def test_resting_motors_keep_the_posture_under_position_control():
    """An action of 0 would stretch the arm."""
    env = MMCReachEnv(control="joint_position", perturbations="action-delay-200")
    env.reset(seed=1)
    before = np.array(env.arm.joint_angles)
    for _ in range(10):
        env.step(np.zeros(3, np.float32))
    np.testing.assert_allclose(env.arm.joint_angles, before, atol=1e-6)
    for _ in range(60):
        env.step(np.zeros(3, np.float32))
    np.testing.assert_allclose(np.sin(env.arm.joint_angles), 0, atol=1e-3)


def test_a_push_begins_and_ends():
    sent = sent_by("motor-offset-0.2-of-2-at-0.2-until-0.4")
    is_pushed = np.abs(sent - ACTIONS)[:, 1] > 1e-9
    assert np.flatnonzero(is_pushed).tolist() == [*range(10, 20)]
    np.testing.assert_array_equal(sent[:, [0, 2]], ACTIONS[:, [0, 2]])


@pytest.mark.parametrize("engine", ["pymunk", "analytic"])
def test_a_locked_joint_may_be_free_again(engine):
    env = MMCReachEnv(engine=engine, perturbations="locked-2-at-0.1-until-0.4")
    env.reset(seed=2)
    angles = []
    for _ in range(40):
        env.step(np.full(3, 0.5, np.float32))
        angles.append(env.arm.joint_angles[1])
    turns = np.abs(np.diff(angles))
    assert turns[:3].min() > 1e-3
    assert turns[6:18].max() < 1e-4
    assert turns[21:].min() > 1e-3


def test_a_change_of_the_senses_ends():
    env = MMCReachEnv(perturbations="sensor-offset-0.5-at-0.1-until-0.3")
    observation, _ = env.reset(seed=0)
    is_off = []
    for _ in range(25):
        observation, *_ = env.step(np.zeros(3, np.float32))
        felt = np.arctan2(observation[3:6], observation[:3])
        off = np.angle(np.exp(1j * (felt - env.arm.joint_angles)))
        is_off.append(bool(np.allclose(off, 0.5, atol=1e-5)))
    assert is_off == [5 <= step < 15 for step in range(1, 26)]


def felt_by(*perturbations, steps=30):
    """Return felt and true joint angles, (steps, 3), of an arm that moves."""
    env = MMCReachEnv(perturbations=[*perturbations])
    env.reset(seed=3)
    felt, true = [], []
    for action in ACTIONS[:steps]:
        observation, *_ = env.step(action)
        felt.append(np.arctan2(observation[3:6], observation[:3]))
        true.append(env.arm.joint_angles)
    return np.array(felt), np.array(true)


def wrapped(angles):
    return np.angle(np.exp(1j * angles))


def test_sensors_are_stuck_then_off_then_rounded():
    width = 2 * np.pi / 32
    felt, true = felt_by("encoder-32", "sensor-offset-0.1-of-1", "sensor-drift-0.2-of-3")
    time = 0.02 * np.arange(1, 31)[:, None]
    off = true + [0.1, 0, 0] + time * [0, 0, 0.2]
    np.testing.assert_allclose(wrapped(felt - np.rint(off / width) * width), 0, atol=1e-6)
    swapped = np.rint(true / width) * width + [0.1, 0, 0] + time * [0, 0, 0.2]
    assert np.abs(wrapped(felt - swapped)).max() > 0.05
    felt, _ = felt_by("stuck-sensor-2", "sensor-offset-0.1", "sensor-drift-0.2")
    np.testing.assert_allclose(np.diff(felt[:, 1]), 0.2 * 0.02, atol=1e-6)


def test_numbers_are_dropped_then_held_then_repeated():
    plain = MMCReachEnv()
    env = MMCReachEnv(perturbations=["held-numbers-0.5", "dropped-numbers-0.2"])
    true, _ = plain.reset(seed=5)
    observation, _ = env.reset(seed=5)
    np.testing.assert_array_equal(observation, true)  # nothing happens at the start
    before, zeros, held = observation, 0, 0
    for action in ACTIONS:
        true, *_ = plain.step(action)
        observation, *_ = env.step(action)
        is_zero, is_held = observation == 0, observation == before
        assert np.all((observation == true) | is_zero | is_held)
        zeros, held, before = zeros + is_zero.mean(), held + is_held.mean(), observation
    # Held numbers may be zeros that were dropped, but dropped ones are never held before.
    assert 0.1 < zeros / 40 < 0.35
    assert 0.4 < held / 40 < 0.65


def test_observations_are_repeated_before_they_are_late():
    shown = []
    for perturbations in (["repeated-observations-0.5"], ["repeated-observations-0.5", "delay-40"]):
        env = MMCReachEnv(perturbations=perturbations)
        first, _ = env.reset(seed=6)
        shown.append([first, *(env.step(action)[0] for action in ACTIONS)])
    on_time, late = shown
    repeats = [np.array_equal(*pair) for pair in pairwise(on_time)]
    assert 0.2 < np.mean(repeats) < 0.5  # never twice in a row: a third
    np.testing.assert_array_equal(late[2:], on_time[:-2])


@pytest.mark.parametrize("name", ["base-turn-20", "cursor-shift-0.3", "base-shift--0.3"])
def test_a_moved_cursor_is_what_counts(name):
    env = MMCReachEnv(perturbations=name)
    _, info = env.reset(seed=0)
    hand, cursor = complex(*info["end_effector"]), complex(*info["cursor"])
    turn = np.exp(1j * np.radians(20))
    moved = {"base-turn-20": hand * turn, "cursor-shift-0.3": hand + 0.3}
    assert cursor == pytest.approx(moved.get(name, hand - 0.3))
    assert info["distance"] == pytest.approx(abs(cursor - complex(*info["target"])))


def test_a_number_says_which_segment_or_motor():
    env = MMCReachEnv(perturbations=["longer-50-of-1", "segment-mass-3-of-2", "shorter-50"])
    body = env.episode.body
    assert body.segment_lengths == pytest.approx((1.5, 1, 0.5))
    assert body.masses == pytest.approx((1, 3, 1))
    change = parse_change("motor-gain-0.4-of-2-at-0.5-until-1.5")
    assert change.name == "motor-gain-0.4-of-2-at-0.5-until-1.5"
    assert change.description == (
        "motors turn 0.4 times as far, motor 2 from the base, from 0.5 s on, until 1.5 s"
    )
    assert as_change(as_plain(change)) == change
    assert as_change(as_plain(dropped_actions(0.1, steps=3))) == dropped_actions(0.1, steps=3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "motor-gain-0.4-of-4",
            "must be a whole number from 1 to 3 .*, or from -3 to -1 .*, got 4",
        ),
        ("rotation-30-of-2", "rotation-of- must be without -of-, got 2"),
        ("delay-100-for-5", "delay-for- must be without -for-, got 5"),
        ("motor-gain-0.4-until-1-of-2", "must have its endings in this order"),
        ("motor-offset-0.2-at-1-until-0.5", "until must be later than .* at 1 s, got 0.5"),
        ("servo-gain-0.5-until-1", "must be a perturbation that can begin within an episode"),
        ("dropped-actions-1.2", "must be from 0 to 1"),
        ("action-delay-5", "action-delay-5 would delay nothing"),
    ],
)
def test_what_cannot_be_is_refused_by_name(name, message):
    with pytest.raises(UserError, match=message):
        MMCReachEnv(perturbations=name)


def test_goal_environments_have_faults_of_motors_but_not_of_senses():
    env = MMCReachGoalEnv(perturbations="motor-gain-0.5")
    env.reset(seed=0)
    *_, info = env.step(np.ones(3, np.float32))
    assert info["action_sent"].tolist() == [0.5] * 3
    for name in ("sensor-offset", "held-numbers", "encoder", "repeated-observations"):
        with pytest.raises(UserError, match="a goal environment must have"):
            MMCReachGoalEnv(perturbations=name)


def test_a_context_repeats_an_episode():
    env = mmc_gym.make("motor-gain-0.3..1+action-delay-0..100+sensor-offset--0.2..0.2-of-2")
    _, info = env.reset(seed=8)
    steps = [env.step(action) for action in ACTIONS]
    env.reset(seed=8, options={"context": info["context"]})
    for step, action in zip(steps, ACTIONS, strict=True):
        np.testing.assert_equal(env.step(action), step)


def test_every_family_has_a_description_and_a_source_of_its_unit():
    for name, family in FAMILIES.items():
        assert family.apply.__doc__, name
        assert not family.has_strength or "{}" in family.description, name
        assert family.unit or not family.has_strength, name


def test_the_page_lists_every_family_in_its_group():
    rows = PAGE.read_text(encoding="utf-8").splitlines()
    for group in GROUPS:
        names = (name for name, family in FAMILIES.items() if family.group == group)
        assert f"| {group} | {' '.join(f'`{name}`' for name in names)} |" in rows


@pytest.mark.parametrize("level", ["easy", "medium", "hard"])
def test_challenges_are_played_by_name(level):
    scenario = parse_scenario(f"pursuit+realworld-{level}")
    assert scenario.name == scenario.family == f"pursuit+realworld-{level}"
    assert (scenario.strength, scenario.unit) == (None, "")
    env = scenario.make()
    observation, _ = env.reset(seed=0)
    for action in ACTIONS:
        assert env.observation_space.contains(observation)
        observation, *_ = env.step(action)


@pytest.mark.parametrize("engine", ["pymunk", "analytic"])
@pytest.mark.parametrize("name", ["locked-2-until-0.1", "locked-2-until-0.005"])
def test_a_lock_from_the_start_opens_in_vectors_too(name, engine):
    single, vector = mmc_gym.make(name, engine=engine), mmc_gym.make_vec(name, 2, engine=engine)
    single.reset(seed=0)
    vector.reset(seed=[0, 0])
    for _ in range(15):
        observation, *_ = single.step(np.full(3, 0.5, np.float32))
        observations, *_ = vector.step(np.full((2, 3), 0.5, np.float32))
        np.testing.assert_array_equal(observations, [observation, observation])
    assert abs(single.unwrapped.arm.joint_velocities[1]) > 1


def test_what_happens_by_chance_ends_with_its_perturbation():
    sent = sent_by("held-actions-1-for-30-at-0.1-until-0.3")
    is_held = (sent != ACTIONS).any(axis=1)
    assert np.flatnonzero(is_held).tolist() == [*range(5, 15)]


def test_a_dropped_action_rests_where_the_last_command_sent_the_motor():
    names = ["dropped-actions-0.3", "motor-gain-0.4", "motor-offset-0.1"]
    env = MMCReachEnv(perturbations=names, control="joint_position")
    env.reset(seed=1, options={"joint_angles": [0, 0, 0]})
    sent = {env.step(np.full(3, 0.5, np.float32))[-1]["action_sent"][0] for _ in range(20)}
    assert {round(float(action), 9) for action in sent} <= {0.1, 0.3}


def test_a_drift_begins_where_its_time_is():
    env = MMCReachEnv(perturbations="sensor-drift-0.2-at-0.2")
    observation, _ = env.reset(seed=1)
    off = []
    for _ in range(20):
        observation, *_ = env.step(np.zeros(3, np.float32))
        felt = np.arctan2(observation[3:6], observation[:3])
        off.append(wrapped(felt - env.arm.joint_angles)[0])
    np.testing.assert_allclose(off[:9], 0, atol=1e-6)
    np.testing.assert_allclose(np.diff(off[8:]), 0.2 * 0.02, atol=1e-6)


def test_vectors_refuse_other_times_and_numbers_within_an_episode():
    vector = mmc_gym.make_vec("motor-gain-0.2..0.8-at-1", 2)
    for other in ("motor-gain-0.2..0.8-at-0.4", "motor-gain-0.2..0.8-of-2-at-1"):
        with pytest.raises(UserError, match="the same perturbations with other distributions"):
            vector.unwrapped.set_perturbations(other)
    vector.unwrapped.set_perturbations("motor-gain-0.1..0.3-at-1")


def test_an_observed_context_says_which_motor_was_drawn():
    scale = FAMILIES["motor-gain"](Range(0.2, 0.8), of=randint(1, 4))
    env = MMCReachEnv(perturbations="motor-gain-0.2-of-3", observe_context=scale)
    observation, _ = env.reset(seed=0)
    assert observation[15:].tolist() == [-1, 1]


def test_a_walk_goes_on_from_what_a_context_beyond_its_range_needs():
    changes = [FAMILIES["delay"](Range(0, 100)), FAMILIES["delay"](Walk(0, 200, 100))]
    single = MMCReachEnv(perturbations=changes)
    vector = MMCReachVectorEnv(1, perturbations=changes, max_episode_steps=None)
    for env in (single, vector):
        env.reset(seed=1)
        env.reset(options={"context": {"delay": 1020}})
    for action in np.vstack([ACTIONS, ACTIONS]):
        np.testing.assert_array_equal(vector.step(action[None])[0][0], single.step(action)[0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FAMILIES["motor-gain"](0.5, of="2"), "of of motor-gain must be a finite number"),
        (lambda: FAMILIES["motor-gain"](0.5, of=1.5), "must be a whole number from 1 to 3"),
        (lambda: dropped_actions(0.5, steps="x"), "steps of dropped-actions must be a finite"),
        (lambda: Walk(-60, None, 5), "high must be a finite number, got None"),
        (lambda: FAMILIES["rotation"](30, at=np.inf), "at must be from 0 to 1000"),
        (lambda: OneOf("realworld-easy", None), "'realworld-easy' is several perturbations"),
    ],
)
def test_numbers_that_make_no_sense_are_refused_by_name(make, message):
    with pytest.raises(UserError, match=message):
        MMCReachEnv(perturbations=make())


def test_segments_may_be_counted_from_the_hand():
    change = SegmentLength(1.2, -2)
    assert parse_change(change.name) == change
    assert change.description.startswith("a segment 20 % longer, segment 2 from the hand")
    assert FAMILIES["motor-gain"](0.5, of=None) == FAMILIES["motor-gain"](0.5)
    mmc_gym.make_vec("hand-mass-0-until-1", 2).reset(seed=0)


@pytest.mark.parametrize(
    ("column", "number", "message"),
    [
        ("motor_gain", np.nan, "column motor_gain must be finite"),
        ("action_dropped", 2.0, "column action_dropped must be from 0 to 1"),
        ("joint_noise", -1.0, "column joint_noise must be from 0 to inf"),
        ("number_held_steps", 0.5, "column number_held_steps must be from 1 to inf"),
    ],
)
def test_columns_of_own_perturbations_are_checked(monkeypatch, column, number, message):
    monkeypatch.setattr("mmc_gym.envs.names.FAMILIES", dict(FAMILIES))

    @mmc_gym.perturbation("own-fault", default=1)
    def own_fault(arms, _):
        getattr(arms, column)[:] = number

    with pytest.raises(UserError, match=message):
        MMCReachEnv(perturbations=own_fault())


def test_whole_strengths_are_drawn_whole():
    with pytest.raises(UserError, match=r"strength of encoder must be a distribution of whole"):
        FAMILIES["encoder"](uniform(32, 480))
    _, info = MMCReachEnv(perturbations=FAMILIES["encoder"](randint(32, 480))).reset(seed=0)
    assert info["context"]["encoder"] % 1 == 0


def test_an_action_is_repeated_after_it_was_sent():
    env = MMCReachEnv(perturbations="repeated-actions-1-for-2")
    env.reset(seed=0)
    sent = [env.step(np.full(3, 0.1 * k, np.float32))[-1]["action_sent"][0] for k in range(1, 7)]
    assert sent == pytest.approx([0.1, 0.1, 0.1, 0.4, 0.4, 0.4])
