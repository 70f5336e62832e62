"""The one grammar for agents, and what is known of each."""

import pickle
import shutil
import sys
from types import ModuleType, SimpleNamespace

import gymnasium as gym
import pytest

from mmc_gym import UserError, make_agent
from mmc_gym._identity import identity
from mmc_gym.agents import AGENTS, REFERENCE, resolve, resolve_all, resolved
from mmc_gym.agents.policy import PRETRAINED, load_policy
from mmc_gym.agents.registry import UNKNOWN
from mmc_gym.agents.resolver import read_card
from mmc_gym.interface import CannotActError

OWN = """
class Still:
    def __init__(self, env):
        self.size = env.action_space.shape[0]

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return [0.0] * self.size, None

NOTHING = 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with a module, a policy and two trainings of another."""
    (tmp_path / "my_agents.py").write_text(OWN)
    for name, copy in (
        ("ppo-3", "lr=0.001/mine"),
        ("ppo-2", "runs/mine-10"),
        ("ppo-1", "runs/mine-9"),
        ("sac-1", "runs/twice-2"),
        ("ppo-1", "runs/twice-1"),
    ):
        for suffix in (".json", ".safetensors"):
            path = tmp_path / f"{copy}{suffix}"
            path.parent.mkdir(exist_ok=True)
            shutil.copy(PRETRAINED / f"{name}{suffix}", path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "my_agents", raising=False)
    return tmp_path


def read(*names, **options):
    agents = resolve_all(names, **options)
    return [(agent.label, agent.training_seed, agent.source) for agent in agents]


@pytest.mark.parametrize("name", AGENTS)
def test_every_name_is_resolved_with_all_that_is_known_of_it(name):
    agent, entry = resolve(name), AGENTS[name]
    assert (agent.label, agent.name, agent.entry) == (name, name, entry)
    source, seed = (f"{name}-0", 0) if entry.training_seeds else (name, None)
    assert (agent.source, agent.training_seed) == (source, seed)
    assert agent.knowledge == entry.knowledge  # of policies, as the card has it
    assert entry.control == agent.control == (agent.card or entry).control


@pytest.mark.parametrize("suffix", ["json", "safetensors"])
def test_a_policy_is_resolved_by_its_path_whatever_that_is(folder, suffix):
    agent = resolve(f"lr=0.001/mine.{suffix}")
    assert (agent.label, agent.source) == ("mine", f"lr=0.001/mine.{suffix}")
    assert (agent.name, agent.training_seed, agent.entry) == ("", 3, None)
    assert agent.knowledge.kind == "yours"
    assert agent.knowledge.senses == AGENTS["ppo"].knowledge.senses
    sha256 = load_policy(PRETRAINED / "ppo-3.json")[1].sha256
    assert agent.fingerprint == resolve("ppo-3").fingerprint == sha256
    assert make_agent(agent.source, gym.make("MMCReach-v0")).card == agent.card
    with pytest.raises(FileNotFoundError, match="ppo-7"):
        resolve_all([f"x=gone/ppo-7.{suffix}"])


def test_one_grammar_holds_for_several_trainings_and_labels(folder):
    assert read("ppo-3", "y=mmc", REFERENCE, "z=lr=0.001/mine.json") == [
        ("ppo-3", 3, "ppo-3"),
        ("y", None, "mmc"),
        (REFERENCE, None, REFERENCE),
        ("z", 3, "lr=0.001/mine.json"),
    ]
    all_five = [(label, seed, f"sac-{seed}") for label in ("other", "sac") for seed in range(5)]
    assert read("other=sac", "sac-*") == all_five
    assert read("sac", every_training=False) == [("sac", 0, "sac-0")]
    mine = [("mine", 1, "runs/mine-9.json"), ("mine", 2, "runs/mine-10.json")]
    assert read("runs/mine-*") == mine  # 9 before 10
    assert read("x=runs/mine-*.safetensors")[1] == ("x", 2, "runs/mine-10.safetensors")
    assert resolve("runs/mine-*").source == "runs/mine-9.json"
    # Their files have the same seed, so they are counted.
    assert [seed for _, seed, _ in read("runs/twice-*")] == [0, 1]
    assert [seed for _, seed, _ in read("lr=0.001/*")] == [3]


def test_a_mapping_gives_labels_and_several_trainings(folder, oracle, frozen):
    def thaw(env):
        return frozen

    env = gym.make("MMCReach-v0")
    by_label = {agent.label: agent for agent in resolve_all([oracle, thaw, "random", "x=mmc"])}
    assert list(by_label) == ["Oracle", "thaw", "random", "x"]
    assert (by_label["Oracle"].factory(env), by_label["thaw"].factory(env)) == (oracle, frozen)
    agents = resolve_all({"a": [oracle, frozen], "b": "runs/mine-*", "c": "mmc"})
    expected = [("a", 0), ("a", 1), ("b", 1), ("b", 2), ("c", None)]
    assert [(agent.label, agent.training_seed) for agent in agents] == expected


def test_a_resolved_agent_travels_with_its_fingerprint_and_is_read_anew(folder):
    agent = resolve("x=my_agents:Still")
    assert (agent.source, agent.training_seed) == ("my_agents:Still", None)
    assert (agent.knowledge, agent.card) == (UNKNOWN, None)
    before = agent.fingerprint
    (folder / "my_agents.py").write_text(OWN.replace("shape[0]", "shape[0] + 1"))
    assert resolve("my_agents:Still").fingerprint != before
    travelled = pickle.loads(pickle.dumps(agent))
    assert (travelled.label, travelled.fingerprint) == ("x", before)
    for process, size in (("this", 3), ("another", 4)):
        if process == "another":
            del sys.modules["my_agents"]
        assert travelled.factory(gym.make("MMCReach-v0")).size == size


def test_a_card_is_read_without_an_import(folder):
    names = ("ppo-3", "lr=0.001/mine.json", "mmc", REFERENCE, "my_agents:Still", "given:make")
    cards = [read_card(name) for name in names]
    assert cards == [resolve("ppo-3").card] * 2 + [None] * 4
    assert "my_agents" not in sys.modules


def test_functions_and_objects_are_called_by_their_own_names_or_class(monkeypatch):
    thing = SimpleNamespace(predict=lambda *observation, deterministic: None)

    def make(env):
        return thing

    assert (resolve(make).label, resolve(make).source_name) == ("make", "given:make")
    assert (resolve(thing).label, resolve(thing).factory(None)) == ("SimpleNamespace", thing)
    monkeypatch.setitem(sys.modules, "of_a_prompt", ModuleType("of_a_prompt"))
    sys.modules["of_a_prompt"].make = make
    assert len(resolve("of_a_prompt:make").fingerprint) == 64  # though no file is known
    assert len(identity("no_such_package.module:make")) == 64
    assert resolve(make).fingerprint != resolve(thing).fingerprint


def test_the_steps_of_a_training_are_known_or_none(folder, frozen):
    agents = resolve_all(["ppo-3", "mmc", REFERENCE, frozen, "runs/mine-9.json", "my_agents:Still"])
    steps = [agent.training_steps for agent in agents]
    ppo_steps = load_policy(PRETRAINED / "ppo-3.json")[1].training_steps
    assert steps == [ppo_steps, 0, 0, None, ppo_steps, None]
    with pytest.raises(CannotActError, match="a hand without an arm"):
        agents[2].factory(gym.make("MMCReach-v0"))


@pytest.mark.parametrize(
    ("agents", "message"),
    [
        (["xyzzy"], "'xyzzy' .* may be mmc-body.*ppo-3"),
        (["ppo-10"], "10 are shipped, ppo-0 to ppo-9"),
        (["ppo-01"], "10 are shipped"),
        (["mmc-3"], "'mmc-3' .* is not trained"),
        (["mmc,ppo"], r"separate names, mmc ppo \(in Python a list, .*got 'mmc,ppo'"),
        ([gym.make("MMCReach-v0")], "got the environment <TimeLimit"),
        ([f"{'x' * 300}=mmc"], "label .* at most 100 characters"),
        ([None], "None .* may be mmc"),
        (["runs/nowhere"], "'runs/nowhere' .* no such file"),
        (["runs"], "one policy, .* got mine-10.json"),
        (["nothing-*.json"], r"match .* got 'nothing-\*.json'"),
        (["=mmc"], "names, got '=mmc'"),
        (["no_such_module:make"], "'no_such_module:make' cannot be imported"),
        ([".my_agents:Still"], "'.my_agents:Still' is not accepted"),
        (["my_agents:nothing"], "'my_agents:nothing' cannot be imported"),
        (["my_agents:NOTHING"], "function .* got 3"),
        (["my_agents.py.json"], "does not hold a policy"),
        ([], "agents must be one or more"),
        (3, "agents must be a list"),
        ({"x": []}, "at least one training"),
        ({3: "mmc"}, "the label of an agent"),
        ({"é" * 60: "mmc"}, "the label of an agent"),
        (["x=ppo", "x=ppo-3"], "different names"),
    ],
)
def test_what_is_no_agent_or_no_list_of_them_is_refused(folder, agents, message):
    for suffix in ("json", "safetensors"):
        (folder / f"my_agents.py.{suffix}").write_text("{}")
    with pytest.raises(UserError, match=message):
        resolve_all(agents)


CODE = (
    "agents/mmc.py",
    "network/model.py",
    "robots/arm.py",
    "interface/contract.py",
    "geometry.py",
)


@pytest.mark.parametrize("changed", [None, *CODE])
def test_changed_code_is_another_fingerprint(changed, tmp_path, monkeypatch):
    unchanged = resolve("mmc").fingerprint
    source, package = resolved.files("mmc_gym"), tmp_path / "mmc_gym"
    for part in ("agents", "network", "robots", "interface"):
        shutil.copytree(source / part, package / part)
    shutil.copy(source / "geometry.py", package)
    monkeypatch.setattr(resolved, "files", lambda name: package)
    if changed:
        (package / changed).write_text((package / changed).read_text() + "# changed")
    assert (resolved.code_digest.__wrapped__() == unchanged) == (changed is None)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("mmc", "MMCAgent(3 joints, joint_delta)"),
        ("mmc-body", "BodyAgent(3 joints, joint_delta)"),
        ("random", "RandomAgent(3 joints, joint_delta)"),
        ("ppo-0", "ppo-0: PolicyAgent(3 joints, joint_delta)"),
    ],
)
def test_an_agent_says_what_it_is(name, shown):
    assert repr(make_agent(name, gym.make("MMCReach-v0"))) == shown
