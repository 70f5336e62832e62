"""What a benchmark ends with: the ranking of its agents as a table, and what went wrong."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from mmc_gym._files import write_atomically
from mmc_gym.benchmark.ranking import BASELINE_AGENT, summarize_battery
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.runner import Manifest, not_played, untrained
from mmc_gym.benchmark.store import read_episodes, read_manifest

RANKING = "ranking.csv"
"""The ranking in a store's folder, as `summarize_battery` returns it, for other programs."""

_PLAIN = str.maketrans({"–": "-", "−": "-", "½": "1/2"})


def print_ranking(console: Console, folder: Path) -> pd.DataFrame:
    """Rank the agents of a store, print the table, write it to `RANKING`, and return it.

    Where nothing can be ranked it prints why, and returns no rows.

    Raises:
        ValueError: if the folder holds no store, or no agent could play.
    """
    manifest = read_manifest(folder)
    if set(manifest["agents"]) == {REFERENCE}:
        console.print(_text(console, f"nothing to rank: {REFERENCE} is a hand without an arm"))
        return pd.DataFrame()
    try:
        ranking = summarize_battery(
            read_episodes(folder), not_played(manifest), untrained(manifest)
        )
    except ValueError:
        _print_reasons(console, manifest)
        raise
    write_atomically(folder / RANKING, ranking.to_csv(index=False, lineterminator="\n"))
    _print_table(console, ranking)
    console.print(_text(console, _note(manifest, ranking)))
    _print_reasons(console, manifest)
    return ranking


def _print_table(console: Console, ranking: pd.DataFrame) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
    rows = ranking.to_dict("records")
    for heading in _cells(rows[0]):
        justify: Any = "left" if heading == "agent" else "right"
        table.add_column(_text(console, heading), justify=justify, vertical="top")
    for row in rows:
        table.add_row(*(_text(console, content) for content in _cells(row).values()))
    console.print(Padding(table, (1, 0)))


def _print_reasons(console: Console, manifest: Manifest) -> None:
    for status in ("skipped", "failed"):
        for line, count in _reasons(manifest, status).items():
            cells = f"{count} cell{'s' * (count != 1)}"
            console.print(_text(console, f"{status}, {cells}: {line}"))


def _cells(row: Mapping[Hashable, Any]) -> dict[str, str]:
    return {
        "rank": str(row["rank"]),
        "agent": str(row["agent"]),
        "success": _interval(row, "success"),
        "settled": _interval(row, "settled"),
        f"better than {BASELINE_AGENT}": _interval(row, "improvement"),
        "time to target [s]": _number(row["time_to_target"], 2),
        "seeds": str(row["training_seeds"] or "-"),
        "not played": str(row["not_played"] or "-"),
    }


def _interval(row: Mapping[Hashable, Any], name: str) -> str:
    low, high = (_number(row[f"{name}_{end}"], 3) for end in ("low", "high"))
    return f"{_number(row[name], 3)} [{low}, {high}]"


def _number(value: float, decimals: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{decimals}f}"


def _note(manifest: Manifest, ranking: pd.DataFrame) -> str:
    one = ranking.iloc[0]
    left_out = len(manifest["environments"]) - int(one["environments"])
    partly = f" ({left_out} more have not been attempted by all)" if left_out else ""
    return (
        f"{one['environments']} environments{partly}, {one['instances']} instances for each "
        "agent and training seed, the same for all. Ranked by success: the fraction of episodes "
        "that end at the target, each environment weighing the same; then by time to target (mean "
        "of medians). settled: interquartile mean of the part of an episode after which the hand "
        f"stays at the target. better than {BASELINE_AGENT}: probability of being settled for "
        "longer in the same episode, ½ if equal. Intervals: 95 % bootstrap over training seeds and "
        "instances; without several training seeds over instances alone. Cells that were not "
        "played count as without success. All cells took "
        f"{sum(manifest['cpu_seconds'].values()):.0f} s of one processor's time; "
        f"{manifest.get('reused', 0)} were there already and not played again.{_mixed(manifest)}"
    )


def _mixed(manifest: Manifest) -> str:
    """What differs among the cells of a store that came about over time."""
    versions = [f"{name} {found}" for name, found in manifest["versions"].items() if ", " in found]
    changed = manifest.get("changed", ())
    return "".join(
        (
            f" They were played with several versions: {'; '.join(versions)}." if versions else "",
            f" Changed since some of their cells were played: {', '.join(changed)}; play them "
            "again in all environments."
            if changed
            else "",
        )
    )


def _reasons(manifest: Manifest, status: str) -> dict[str, int]:
    """How many cells of an agent have come to nothing for the same reason."""
    counts: dict[str, int] = {}
    for entry in manifest[status]:
        line = f"{entry['agent']}: {entry['reason']}"
        counts[line] = counts.get(line, 0) + 1
    return counts


def _text(console: Console, content: str) -> Text:
    if not console.is_terminal or not console.encoding.lower().startswith("utf"):
        content = content.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(content)
