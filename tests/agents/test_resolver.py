"""Finding out which agent is meant, and what is known of it."""

import shutil
import sys
from types import ModuleType, SimpleNamespace

import gymnasium as gym
import pytest

from mmc_gym import make_agent
from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS, resolve, resolver, shipped_seeds
from mmc_gym.agents.policy import PRETRAINED, load_policy
from mmc_gym.agents.registry import UNKNOWN

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
    """A working directory with a module and a policy of the user's."""
    (tmp_path / "my_agents.py").write_text(OWN)
    (tmp_path / "lr=0.001").mkdir()
    for suffix in (".json", ".safetensors"):
        shutil.copy(PRETRAINED / f"ppo-3{suffix}", tmp_path / "lr=0.001" / f"mine{suffix}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "my_agents", raising=False)
    return tmp_path


@pytest.mark.parametrize("name", AGENTS)
def test_every_name_is_resolved_with_all_that_is_known_of_it(name):
    found, entry = resolve(name), AGENTS[name]
    assert (found.label, found.name, found.entry) == (name, name, entry)
    assert found.source == (f"{name}-0" if entry.training_seeds else name)
    assert found.training_seed == (0 if entry.training_seeds else None)
    assert found.knowledge == entry.knowledge  # of policies, as the card has it
    assert entry.knowledge.kind != "yours"
    assert entry.control == found.control == (found.card or entry).control
    assert shipped_seeds(name) == list(range(entry.training_seeds))
    assert len(found.fingerprint) == 64
    assert found.acts_on_batches


def test_a_training_is_resolved_by_name_and_seed():
    found = resolve("ppo-3")
    assert (found.label, found.source, found.name, found.training_seed) == (
        *("ppo-3", "ppo-3", "ppo", 3),
    )
    assert found.fingerprint == load_policy(PRETRAINED / "ppo-3.json")[1].sha256


@pytest.mark.parametrize("suffix", ["json", "safetensors"])
def test_a_policy_is_resolved_by_its_path_whatever_that_is(folder, suffix):
    found = resolve(f"lr=0.001/mine.{suffix}")
    found.check()
    assert (found.label, found.source) == ("mine", f"lr=0.001/mine.{suffix}")
    assert (found.name, found.training_seed, found.entry) == ("", 3, None)
    assert found.knowledge.kind == "yours"
    assert found.knowledge.senses == AGENTS["ppo"].knowledge.senses
    assert found.fingerprint == resolve("ppo-3").fingerprint
    assert found.acts_on_batches
    assert make_agent(found.source, gym.make("MMCReach-v0")).card == found.card


def test_an_own_class_is_resolved_by_module_and_name(folder):
    found = resolve("my_agents:Still")
    assert (found.label, found.source, found.training_seed) == (*["my_agents:Still"] * 2, None)
    assert (found.knowledge, found.card) == (UNKNOWN, None)
    env = gym.make("MMCReach-v0")
    assert found.factory(env).size == make_agent("my_agents:Still", env).size == 3
    assert not found.acts_on_batches
    before = found.fingerprint
    (folder / "my_agents.py").write_text(f"{OWN}# changed")
    assert resolve("my_agents:Still").fingerprint != before


def test_functions_and_objects_are_called_by_their_own_names_or_class():
    thing = SimpleNamespace(predict=lambda *observation, deterministic: None)

    def make(env):
        return thing

    assert (resolve(make).label, resolve(make).factory(None)) == ("make", thing)
    assert (resolve(thing).label, resolve(thing).factory(None)) == ("SimpleNamespace", thing)
    assert resolve(make).source == resolve(thing).source == ""
    assert resolve(make).fingerprint != resolve(thing).fingerprint


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        *(
            (name, "agent '.*' is not accepted. It may be mmc-body.*ppo-3")
            for name in ("xyzzy", "")
        ),
        ("mcm", "agent 'mcm' is not accepted; did you mean 'mmc'"),
        ("MMC", "agent 'MMC' is not accepted; did you mean 'mmc'"),
        ("ppo-10", "did you mean 'ppo-1'"),
        ("mmc-0", "did you mean 'mmc'"),
        *((name, "did you mean 'ppo") for name in ("ppo--1", "ppo-01", "ppo-")),
        *((thing, f"agent {thing} is not accepted. It may be mmc") for thing in (None, 3)),
        ("runs/nowhere", "agent 'runs/nowhere' must be .* there is no such file"),
        ("no_such_module:make", "'no_such_module:make' cannot be imported"),
        (".my_agents:Still", "agent '.my_agents:Still' is not accepted"),
        ("my_agents:nothing", "'my_agents:nothing' cannot be imported"),
        ("my_agents:NOTHING", "must be a function of the environment, got 3"),
        ("my_agents.py.json", "does not hold a policy"),
    ],
)
def test_what_is_no_agent_is_an_error_of_the_user(folder, agent, message):
    for suffix in ("json", "safetensors"):
        (folder / f"my_agents.py.{suffix}").write_text("{}")
    with pytest.raises(UserError, match=message):
        resolve(agent).check()


def test_where_no_file_is_known_there_is_no_fingerprint(monkeypatch):
    monkeypatch.setitem(sys.modules, "of_a_prompt", ModuleType("of_a_prompt"))
    for source in ("of_a_prompt:make", "no_such_package.module:make"):
        assert resolve(source).fingerprint == ""


def test_a_missing_policy_is_known_to_be_one_and_missing():
    found = resolve("gone/ppo-7.json")
    assert found.label == "ppo-7"
    with pytest.raises(FileNotFoundError):
        found.check()


def test_changed_code_is_another_fingerprint(tmp_path, monkeypatch):
    package = tmp_path / "mmc_gym"
    source = resolver.files("mmc_gym")
    for part in ("agents", "network"):
        shutil.copytree(source / part, package / part)
    shutil.copy(source / "interface.py", package)
    monkeypatch.setattr(resolver, "files", lambda name: package)
    digests = []
    for changed in (None, "agents/mmc.py", "network/model.py", "interface.py"):
        if changed is not None:
            (package / changed).write_text((package / changed).read_text() + "# changed")
        digests.append(resolver.code_digest.__wrapped__())
    assert digests[0] == resolve("mmc").fingerprint
    assert len(set(digests)) == len(digests)
