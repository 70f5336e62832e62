"""The code and the commands of every page run, each in a new process.

They run in a folder that has what the pages speak of: a benchmark, trainings, a model of
stable-baselines3, and modules of the reader.  Long ones are shortened: see `SHORTER` and `SMALL`.
"""

import re
import runpy
import shlex
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from mmc_gym.benchmark.suite import SCENARIOS
from tests.processes import run_python

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SHIPPED = ROOT / "mmc_gym" / "agents" / "pretrained"
PAGES = [ROOT / "README.md"]
for folder in (".", "concepts", "how-to", "results"):
    PAGES += sorted((DOCS / folder).glob("*.md"))

SHORTER = {r"\.learn\([\d_]+\)": ".learn(1)"}  # one rollout
SMALL = {  # options for less work, unless the command has them
    "benchmark": {"--episodes": "1", "--jobs": "1", "--agents": "mmc", "--scenarios": "random"},
    "adapt": {"--subjects": "1", "--jobs": "1"},
    "compare": {"--episodes": "2"},
    "train": {"--steps": "2000", "--out": "trained"},
}
# Libraries of which not all are installed everywhere; they may warn.
OTHERS = ("d3rlpy", "minari", "ray", "torchrl")
OF_RLLIB = ("tree", "lz4", "ormsgpack")  # Ray alone does not bring them
# A window, a cluster, every training, and a whole protocol: their options are checked only.
TOO_MUCH = ("play", "--cluster", "--all", "--protocol", "--yardstick")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DOCS.is_dir(), reason="the documentation is not here"),
]


def blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(text):
    """Return the commands of mmc-gym on a page, without their comments."""
    lines = "\n".join(blocks(text, "sh")).replace("\\\n", "").splitlines()
    lines = [line for line in lines if line.startswith("mmc-gym ")]
    return [shlex.join(shlex.split(line, comments=True)) for line in lines]


def run(folder, *command):
    """Run a command of Python in a folder; return what it prints."""
    paths = {"PYTHONPATH": str(ROOT), "MINARI_DATASETS_PATH": str(folder / "datasets")}
    return run_python(*command, folder=folder, MPLBACKEND="Agg", **paths)


def code_of(page, text):
    """Return the code of a how-to page that has this text."""
    page = (DOCS / "how-to" / page).read_text()
    return next(code for code in blocks(page, "python") if text in code)


MODEL = """
import mmc_gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stacked import stack
PPO("MlpPolicy", make_vec_env("MMCReach-v0", 1, wrapper_class=stack)).save("stacked")
model = PPO("MlpPolicy", make_vec_env("MMCReach-v0", 1))
model.save("model")
model.save("mine")
model.save("logs/ppo/MMCReach-v0_1/MMCReach-v0")
"""


def fill(folder):
    for name in ("ppo-1", "mine-1", "mine-2"):
        (folder / "runs" / name).mkdir(parents=True)
        for file in SHIPPED.glob("ppo-1.*"):
            shutil.copy(file, folder / "runs" / name)
    (folder / "my").mkdir()
    (folder / "logs" / "ppo" / "MMCReach-v0_1").mkdir(parents=True)
    hyperparameters = ROOT / "mmc_gym" / "training" / "hyperparams" / "ppo.yml"
    shutil.copy(hyperparameters, folder / "my" / "ppo-mine.yml")
    for name in ("my_agents.py", "my_tasks.py", "my_measures.py"):
        shutil.copy(ROOT / "examples" / "bring_your_own.py", folder / name)
    (robot,) = blocks((DOCS / "how-to" / "urdf.md").read_text(), "xml")
    (folder / "arm.urdf").write_text(robot)
    (folder / "stacked.py").write_text(code_of("stable-baselines3.md", "def stack"))
    (folder / "mine.py").write_text(code_of("adaptation.md", "def first"))
    page = (DOCS / "how-to" / "adaptation.md").read_text()
    for name, text in zip(("aba", "learners"), blocks(page, "yaml"), strict=True):
        (folder / f"{name}.yml").write_text(text)
    (folder / "people.csv").write_text("trial,adaptation\n40,0.1\n87,0.9\n")
    (folder / "studies").symlink_to(ROOT / "studies")  # some commands are run in a clone
    run(folder, "-c", MODEL)
    for command in ("mmc-gym benchmark", "mmc-gym adapt rotation-30 --agents mmc"):
        run(folder, "-m", "mmc_gym.cli", *small(command))


@pytest.fixture
def here(once, tmp_path):
    """A folder with what the reader of the pages has made before."""
    return shutil.copytree(once("reader", fill), tmp_path / "here", symlinks=True)


def small(command):
    """Return the arguments of a command, with options for less work."""
    _, name, *options = shlex.split(command)
    more = {key: value for key, value in SMALL.get(name, {}).items() if key not in options}
    return [name, *options, *(part for option in more.items() for part in option)]


PYTHON = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(blocks(page.read_text(), "python"), start=1)
]
COMMANDS = sorted({command for page in PAGES for command in commands(page.read_text())})
LONG_COMMANDS = [command.split() for command in COMMANDS if {*command.split()} & {*TOO_MUCH}]


@pytest.mark.parametrize("code", PYTHON)
def test_the_code_of_a_page_runs(code, here):
    others = {*re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE)} & {*OTHERS}
    others |= {*OF_RLLIB} if "ray.rllib" in code else set()
    if missing := [name for name in sorted(others) if find_spec(name) is None]:
        pytest.skip(f"not installed: {', '.join(missing)}")
    if "load_dataset" in code:
        run(here, "-c", code_of("other-libraries.md", "create_dataset"))
    for long, short in SHORTER.items():
        code = re.sub(long, short, code)
    run(here, *(() if others else ("-W", "error")), "-c", code)


@pytest.mark.parametrize(
    "command", [text for text in COMMANDS if text.split() not in LONG_COMMANDS]
)
def test_the_command_of_a_page_runs(command, here):
    assert run(here, "-m", "mmc_gym.cli", *small(command))


def test_options_of_commands_that_take_too_much_exist(tmp_path):
    assert LONG_COMMANDS
    for _, name, *arguments in LONG_COMMANDS:
        options = run(tmp_path, "-m", "mmc_gym.cli", name, "--help")
        assert all(re.search(rf"{flag}\b", options) for flag in arguments if flag[:2] == "--")


def test_the_code_of_the_pages_of_scenarios_runs(tmp_path):
    generate = runpy.run_path(str(DOCS / "generate.py"))
    scenarios = generate["all_scenarios"]()
    assert {*SCENARIOS} <= {*scenarios}
    pages = [generate["scenario_page"](scenario, "", None) for scenario in scenarios.values()]
    run(tmp_path, "-c", "\n".join(code for page in pages for code in blocks(page, "python")))
