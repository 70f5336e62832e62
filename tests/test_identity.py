"""What your own things depend on is part of the identity of their results."""

import importlib
import os
import sys
import threading
import types
import warnings
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym
from mmc_gym import MismatchWarning, _identity
from mmc_gym._files import import_modules
from mmc_gym._identity import identity, warn_of_unseen
from mmc_gym.agents import resolve
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.envs.scenarios import as_json, parse_environment, parse_scenario
from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.measures.catalogue import own_measures
from tests.processes import run_python

FILES = {
    "own_things.py": """
import numpy as np
import own_room.helper
from own_far import FAR
class Still:
    def __init__(self, env=None, gain=1): self.gain = gain
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros(3), state
def act(observation): return np.full(3, own_room.helper.SPEED)
def late(env):
    import own_late, importlib
    importlib.import_module("own_literal")
    return Still()
def world(**arguments):
    import mmc_gym
    return mmc_gym.make(own_room.helper.NAME, **arguments)
STILL = Still()
""",
    "own_room/__init__.py": "",
    "own_room/helper.py": "from . import beside\nfrom .beside import *\nNAME, SPEED = 'random', 0",
    "own_room/beside.py": "import own_things",
    "own_far.py": "FAR = 1\ntry: import own_missing\nexcept ImportError: pass",
    "own_late.py": "import own_later",
    "own_later.py": "LATER = 1",
    "own_literal.py": "",
    "own_other.py": "OTHER = 1",
    "own_registry.py": """
import mmc_gym
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.measures import measure
import own_far
@mmc_gym.perturbation("own-turn", unit="°", default=30, neutral=0)
def turn(arms, degrees): VisuomotorRotation.apply(arms, degrees)
@measure(label="own far")
def own_far_measure(episode): return own_far.FAR
""",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Your modules, in the working directory."""
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("own_")]:
        del sys.modules[name]


def things():
    """Return a function that returns the identity of each kind of your own things, by name."""
    module = importlib.import_module("own_things")
    room = module.own_room
    return {
        "a function": lambda: resolve(module.act).fingerprint,
        "a class": lambda: resolve(module.Still).fingerprint,
        "an object": lambda: resolve(module.Still()).fingerprint,
        "a lambda that calls one": lambda: resolve(lambda seen: module.act(seen)).fingerprint,
        "a lambda that calls a module": lambda: resolve(lambda _: room.helper.SPEED).fingerprint,
        "a method": lambda: resolve(module.STILL.predict).fingerprint,
        "a factory": lambda: resolve(partial(module.Still, gain=2)).fingerprint,
        "module:name": lambda: resolve("own_things:act").fingerprint,
        "an environment's function": lambda: settings_of(module.world),
        "an environment's name": lambda: settings_of("own_things:world"),
        "a lambda of an environment": lambda: settings_of(lambda **more: module.world(**more)),
    }


def settings_of(env):
    return parse_environment(env).inspected().settings["code"]


def change(file):
    file.write_text(f"{file.read_text()}\n# changed")


IMPORTED = [name for name in FILES if name not in ("own_other.py", "own_registry.py")]


@pytest.mark.parametrize("name", [*IMPORTED, "own_other.py"])
def test_a_change_of_any_module_that_is_imported_is_another_identity(name, folder):
    taken = things()
    before = {thing: take() for thing, take in taken.items()}
    assert all(take() == before[thing] for thing, take in taken.items())
    change(folder / name)
    has_changed = {thing: take() != before[thing] for thing, take in taken.items()}
    assert set(has_changed.values()) == {name in IMPORTED}, has_changed
    assert not {"own_late", "own_later", "own_other"} & sys.modules.keys()  # nothing is imported


def test_arguments_and_captured_values_are_part_of_an_identity(folder):
    module = importlib.import_module("own_things")

    def make(gain):
        return lambda **arguments: gym.Wrapper(module.world(**arguments)) if gain else None

    for value, other_value in (
        (partial(module.Still, gain=2), partial(module.Still, gain=3)),
        (module.Still(gain=2), module.Still(gain=3)),
        (make(2), make(3)),
    ):
        assert identity(value) == identity(value) != identity(other_value)
    assert settings_of(make(2)) != settings_of(make(3))
    assert as_json({"f": partial(np.add, 1)}) != as_json({"f": partial(np.add, 2)})


def test_an_id_depends_on_the_function_that_it_is_registered_with(folder):
    gym.register("OwnArm-v0", entry_point="own_things:world")
    try:
        before = settings_of("OwnArm-v0")
        change(folder / "own_far.py")
        assert settings_of("OwnArm-v0") != before
    finally:
        del gym.registry["OwnArm-v0"]


@pytest.mark.usefixtures("forget_what_is_registered")
def test_registered_perturbations_and_measures_depend_on_their_modules(folder, tmp_path):
    import_modules(["own_registry"])
    experiment = Experiment("own", [Block("all", 2, "own-turn-30")])
    cells = []

    def run():
        mmc_gym.run_experiment(
            experiment, ["ik-dls"], 1, out=tmp_path / "runs", jobs=1,
            on_progress=lambda done, total: cells.append((done, total)),
        )  # fmt: skip
        (measure,) = own_measures()
        scenario = parse_scenario("own-turn-30").settings
        return cells[-2 if cells[-2:][0] != cells[-1] else -1], scenario, identity(measure.of)

    _, scenario, measure = run()
    first = len(cells)
    assert run()[1:] == (scenario, measure) and cells[first:] == [(1, 1)]  # it is kept
    change(folder / "own_far.py")
    again, changed = len(cells), run()
    assert cells[again:] == [(0, 1), (1, 1)]
    assert changed[1] != scenario and changed[2] != measure


SCRIPT = """
import sys
sys.path.insert(0, {source!r})
from dataclasses import dataclass
from enum import Enum
import own_things
from mmc_gym._identity import identity
class Kind(Enum):
    a, b = 1, 2
@dataclass
class Mine(own_things.Still):
    names = frozenset("abcdefgh")
    gain: float = 1.0
    def __post_init__(self):
        super().__init__(gain=self.gain)
    def predict(self, observation, *rest):
        return {{"x"}} if observation in {{"a", "b", "c"}} else own_things.act(observation)
def make(env):
    from own_late import nothing
    return Mine({gain})
print(identity(Mine), identity(Mine(2.0)), identity(make), identity(Kind), identity(Kind.a))
{below}
"""


def test_a_script_counts_by_the_code_that_is_used_wherever_it_stands(folder):
    def identities(gain=1, above="", below=""):
        script = above + SCRIPT.format(
            source=os.path.dirname(mmc_gym.__path__[0]), gain=gain, below=below
        )
        (folder / "script.py").write_text(script)
        return run_python("script.py").split()

    before = identities()
    assert identities(above="\n\n# plot\n", below="print(3)")[:5] == before
    changed = [now != then for now, then in zip(identities(gain=2), before)]
    assert changed == [False, False, True, False, False]
    change(folder / "own_far.py")
    assert [now != then for now, then in zip(identities(), before)] == [True] * 3 + [False] * 2
    before = identities()
    change(folder / "own_later.py")  # imported by what `make` imports when it is called
    assert [now != then for now, then in zip(identities(), before)][2]


def test_what_is_not_seen_is_said_where_results_are_used_again(folder):
    locked = importlib.import_module("own_things").Still()
    locked.lock = threading.Lock()
    (folder / "own_plugin.py").write_text(
        "import importlib, own_things\n"
        "def make(env, name='own_far'): return importlib.import_module(name) and own_things.Still()"
    )
    agents = {"locked": locked, "plugin": "own_plugin:make"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        benchmark(agents, "runs", ["random"], 1, jobs=1)  # nothing is used again
    with pytest.warns(MismatchWarning, match="what Still holds, what is imported by a comp"):
        assert benchmark(agents, "runs", ["random"], 1, jobs=1).reused == 2
    sys.modules["own_prompt"] = types.ModuleType("own_prompt")
    with pytest.warns(MismatchWarning, match="whether the module own_prompt changed is not seen"):
        warn_of_unseen([{"code": identity("own_prompt:make")}])


def test_shipped_things_and_libraries_have_no_files_in_an_identity(folder, monkeypatch):
    monkeypatch.setattr(_identity, "_source", None)
    for thing in (mmc_gym.make, np.add, gym.Wrapper, "mmc_gym.agents:MMCAgent", "own_missing:x"):
        assert identity(thing) == identity(thing)
    assert "code" not in str(parse_scenario("rotation-30+delay-20").settings)
