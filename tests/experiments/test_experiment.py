"""Facts about experiments as data: checked, planned, printed and drawn."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from mmc_gym import UserError
from mmc_gym.envs.names import parse_change
from mmc_gym.experiments.experiment import (
    EXPERIMENTS,
    Block,
    Condition,
    Experiment,
    Probe,
    find_experiment,
)

YAML = """
name: mine
blocks:
  - {name: baseline, trials: 4}
  - name: learning
    trials: 8
    perturbations: [rotation-30]
    targets: [0, 90]
    gradual: true
    rest: 60
    probes: [{name: catch, every: 4}]
"""


def test_an_experiment_from_yaml_equals_that_in_python(tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text(YAML)
    with pytest.raises(UserError, match="did you mean 'savings'"):
        find_experiment("saving-30")
    catch = Probe("catch", 4)
    learning = Block("learning", 8, ("rotation-30",), (0, 90), (catch,), gradual=True, rest=60)
    mine = Experiment("mine", (Block("baseline", 4), learning))
    assert find_experiment(file) == mine == Experiment(**mine.settings)


@pytest.mark.parametrize("name", [*EXPERIMENTS, *(f"{name}--10" for name in EXPERIMENTS)])
def test_every_experiment_can_be_planned_printed_and_drawn(name: str) -> None:
    experiment = find_experiment(name)
    schedule = experiment.schedule
    assert [trial.trial for trial in schedule] == list(range(len(schedule)))
    assert schedule[0].strength == 0
    assert Experiment(**yaml.safe_load(str(experiment))) == experiment
    (axes,) = experiment.plot().axes
    shown = {text.get_text().split(", ")[-1] for text in axes.texts}
    assert {block.name for block in experiment.blocks} <= shown


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("interference-0.1", ["rotation-0.1", "rotation--0.1", "rotation-0.1"]),
        ("spontaneous-recovery--40", ["rotation--40", "rotation-40", "clamp-0"]),
        ("cursor-jump-7", ["cursor-jump-7", "cursor-jump--7"]),
    ],
)
def test_the_strength_in_a_name_is_that_of_its_perturbations(name, changes) -> None:
    assert [change.name for change in find_experiment(name).changes] == changes
    assert find_experiment("instructed-aim-25").blocks[1].aim == -25
    for refused in ("cursor-jump-200", "instructed-aim-200"):
        with pytest.raises(UserError, match=f"experiment '{refused}' is not possible: .*200"):
            find_experiment(refused)


def test_one_of_so_many_trials_is_a_probe_at_a_place_that_differs() -> None:
    block = Block("learning", 80, ("force-field-60",), probes=(Probe("catch", 8),))
    probes = [trial for trial in Experiment("mine", (block,)).schedule if trial.probe]
    assert [trial.trial // 8 for trial in probes] == list(range(10))
    assert len({trial.trial % 8 for trial in probes}) > 3
    assert all((trial.condition.perturbations, trial.probe) == ((), "catch") for trial in probes)


@pytest.mark.parametrize("strength", [-30.0, 0.01, 1e6])
def test_perturbations_of_a_gradual_block_grow_exactly_to_their_strength(strength) -> None:
    change = parse_change("rotation").with_strength(strength)
    experiment = Experiment("grows", (Block("grows", 3, change, gradual=True),))
    strengths = [trial.strength for trial in experiment.schedule]
    assert strengths == [strength / 3, strength * 2 / 3, strength]
    assert experiment.schedule[2].condition.perturbations == (change,)
    assert Experiment(**experiment.settings) == experiment


@pytest.mark.parametrize(
    ("fields", "kind"),
    [
        ({}, "catch"),
        ({"perturbations": "clamp-0"}, "clamp"),
        ({"perturbations": "clamp-0", "targets": (90,)}, "transfer"),
        ({"perturbations": "cursor-jump-10"}, "jump"),
        ({"target_jump": 10}, "jump"),
        ({"perturbations": "rotation-60"}, "other"),
        ({"perturbations": "rotation-60", "kind": "transfer"}, "transfer"),
    ],
)
def test_the_kind_of_a_probe_follows_from_what_it_changes_or_is_given(fields, kind) -> None:
    assert Probe("mine", 4, **fields).measured_as == kind


@pytest.mark.parametrize("name", ["longer-50", "hand-mass-3", "locked-2", "gravity-10"])
def test_what_has_no_measure_of_learning_is_refused_but_in_all_trials(name) -> None:
    for refused in (Block, Probe):
        with pytest.raises(UserError, match=f"perturbations must be rotation, .*{name} may"):
            refused("a", 8, name)
    assert Experiment("x", (Block("a", 8, "rotation-30"),), noise=name).noise[0].name == name


def test_a_subject_meets_all_targets_before_one_comes_again() -> None:
    experiment = find_experiment("rotation-30")
    targets, other_targets = experiment.targets_of(1), experiment.targets_of(2)
    assert (np.sort(targets[:56].reshape(-1, 8)) == np.arange(0, 360, 45)).all()
    assert (targets != other_targets).any()


def test_the_target_leaves_the_start_at_the_go_cue_and_jumps_in_flight() -> None:
    condition = Condition(go_cue=0.1, target_jump=10.0)
    env = find_experiment("target-jump").scenario(condition).make()
    infos = [env.reset(options={"trial": 0})[1]]
    infos += [env.step(np.zeros(3, np.float32))[4] for _ in range(15)]
    ways = np.array([info["target"] for info in infos]) - infos[0]["target"]
    assert (ways[:5] == 0).all()
    assert ways[5:10] == pytest.approx(np.tile([0.6, 0.0], (5, 1)))
    assert ways[10:] == pytest.approx(np.tile([0.6, 0.06], (6, 1)))


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"blocks": []}, "blocks"),
        ({"blocks": [{"name": "a", "trials": 0}]}, "blocks.0.trials .* got 0"),
        ({"blocks": [{"name": "a", "trials": 1, "perturbations": ["rotate"]}]}, "rotate"),
        ({"blocks": [{"name": "a", "trials": 1, "trial": 1}]}, "blocks.0.trial is not known"),
        ({"blocks": [{"name": "a", "trials": 4, "probes": [{"name": "b", "every": 1}]}]}, "every"),
        ({"blocks": [Block("a", 1, "rotation"), Block("b", 1, "force-field")]}, "of one kind"),
        ({"name": "Mine!"}, "name"),
    ],
)
def test_what_is_no_experiment_is_refused(entries, message) -> None:
    with pytest.raises(UserError, match=message):
        Experiment(**{"name": "mine", "blocks": [{"name": "a", "trials": 1}], **entries})


@pytest.mark.parametrize("every", [(2, 3, 7), (7, 3, 2), (2, 4, 5), (3, 3, 4)])
def test_probes_of_any_share_find_a_place_in_each_of_their_groups(every) -> None:
    probes = tuple(Probe(str(count), count) for count in every)
    block = Block("a", 84, ("rotation-30",), probes=probes)
    for seed in range(30):
        trial_probes = block.probes_by_trial(seed)
        for probe in set(probes):
            starts = range(0, 84 - probe.every + 1, probe.every)
            counts = [trial_probes[start : start + probe.every].count(probe) for start in starts]
            assert counts == [probes.count(probe)] * len(counts)
