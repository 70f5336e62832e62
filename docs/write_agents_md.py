"""Write AGENTS.md, which tells coding assistants what there is, from the package itself.

python docs/write_agents_md.py
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import mmc_gym
from mmc_gym._files import write_atomically
from mmc_gym.agents import Predictor
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.listing import Listing

ROOT = Path(__file__).resolve().parents[1]
SECTIONS = ("Action Space", "Observation Space", "Rewards", "Starting State", "Episode End")


def agents_text() -> str:
    """Return the whole file."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    example = re.search(r"^```python\n.*?^```", readme, re.DOTALL | re.MULTILINE)
    assert example is not None
    lines = [
        "# mmc-gym, for coding assistants",
        "",
        "Written by `python docs/write_agents_md.py` from the package; do not edit. People start",
        "at README.md, those who change the package at CONTRIBUTING.md.",
        "",
        inspect.getdoc(mmc_gym) or "",
        "",
        "## Ten lines",
        "",
        example[0],
        "",
        "## Contract",
        "",
        f"Agents have `predict{inspect.signature(Predictor.predict)}`, for one observation or a",
        "batch of them. What an agent remembers is `state`; nothing is kept in attributes. Lengths",
        "are in segment lengths, angles in radians, time in seconds; arrays lead with batch axes.",
        "The same seed gives the same result. A mistake in an argument raises `UserError`, a",
        "`ValueError`, which names the argument, the value and what is accepted.",
        "",
        *environment(),
        "## Names",
        "",
        "`<perturbation>[-<strength>][-told]`, with any strength, in ids (`MMCReachDelay40-v0`),",
        'in `perturbations=["delay-150"]`, in the benchmark and in file names.',
        "",
        *listed("Agents, for `mmc_gym.make_agent(name, env)`", mmc_gym.list_agents()),
        *listed("Tasks, for `task=`", mmc_gym.list_tasks()),
        *listed("Perturbations, for `perturbations=[...]`", mmc_gym.list_perturbations()),
        *listed("Measures", mmc_gym.list_measures()),
        "## Commands",
        "",
        *commands(),
        "",
        "`mmc-gym COMMAND --help` says more, `make test` runs lint, types, import rules and tests.",
        "",
    ]
    return "\n".join(lines)


def environment() -> list[str]:
    """Return the sections of the environment's docstring that programs rely on."""
    text = inspect.getdoc(MMCReachEnv) or ""
    found = re.findall(r"^## ([\w ]+)\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    lines = []
    for heading, body in found:
        if heading in SECTIONS:
            lines += [f"### MMCReach-v0: {heading}", "", body.strip(), ""]
    return lines


def listed(heading: str, listing: Listing) -> list[str]:
    """Return a list of names with a line on each."""
    return [f"### {heading}", "", *(f"- `{row.name}`: {row.what}" for row in listing.rows), ""]


def commands() -> list[str]:
    """Return a line on every command."""
    from mmc_gym import cli

    names = re.findall(r"^@_app\.command.*\ndef (\w+)", inspect.getsource(cli), re.MULTILINE)
    docs = {name: inspect.getdoc(getattr(cli, name)) or "" for name in names}
    return [f"- `mmc-gym {name.strip('_')}`: {text.splitlines()[0]}" for name, text in docs.items()]


if __name__ == "__main__":
    print(f"wrote {write_atomically(ROOT / 'AGENTS.md', agents_text())}")
