"""Inverse kinematics: ours and peers, for arms as given and for arms that changed.

Run it with `python benchmarks/inverse_kinematics.py`.  Solvers that are not installed (they are in
the extra `inverse-kinematics`) are named and left out.  They take turns, a block of problems each,
on one thread, and times are those of the process, so other programs matter little.  Pinocchio's
forward kinematics scores every posture, which also has to be within the limits and in time.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio
import tyro
from scipy.optimize import minimize
from solvers import (
    BUDGET,
    LOOSE,
    ROBOTS,
    SOLVERS,
    TIGHT,
    Arm,
    Array,
    DampedLeastSquares,
    Problem,
    Solver,
)

Row: TypeAlias = dict[str, Any]
Solvers: TypeAlias = Mapping[str, Solver]
Answer: TypeAlias = tuple[float, float, float]  # distance, angle, seconds
TURN = 50  # problems
LOOKS = 10  # at the hand of an arm with a longer link
JUMP = 0.2  # rad, of a joint between neighbours on a path


@dataclass
class Arguments:
    """Compare solvers of inverse kinematics.

    Attributes:
        robots: their names; nothing was tuned on ur10, xarm7, z1 and baxter.
        tables: their names.
        problems: of the table `reach`; the others have a share of it.
        peer_problems: at most so many of them for solvers that are not ours.
        seed: of all that is drawn.
        solvers: their names in the tables; none for all.
        out: folder of the rows as CSV, and of the tables in Markdown.
    """

    robots: tuple[str, ...] = ("panda", "ur5", "iiwa", "ur10", "xarm7")
    tables: tuple[str, ...] = ("reach", "batch", "locked", "longer", "outside", "path", "elbow")
    problems: int = 10_000
    peer_problems: int = 10_000
    seed: int = 1
    solvers: tuple[str, ...] = ()
    out: Path = Path("runs/inverse-kinematics")


class Judge:
    """Pinocchio's forward kinematics of an arm."""

    def __init__(self, arm: Arm) -> None:
        self.limits = arm.limits.T
        self.model = pinocchio.buildModelFromXML(arm.urdf())
        self.data = self.model.createData()
        self.frames = [self.model.getFrameId(name) for name in ("hand", "elbow")]

    def see(self, posture: Array) -> tuple[Array, Array]:
        """Return the pose of the hand, (4, 4), and the place of the elbow, (3,)."""
        pinocchio.framesForwardKinematics(self.model, self.data, posture)
        hand, elbow = (self.data.oMf[frame] for frame in self.frames)
        return hand.homogeneous, elbow.translation.copy()

    def errors(self, posture: Array | None, problem: Problem) -> tuple[float, float]:
        """Return distance and angle to go, which are infinite for what is no solution."""
        low, high = self.limits
        if posture is None or not np.all((posture > low - 1e-4) & (posture < high + 1e-4)):
            return np.inf, np.inf
        if any(abs(posture[joint] - angle) > 1e-6 for joint, angle in problem.held.items()):
            return np.inf, np.inf
        hand, elbow = self.see(np.clip(posture, low, high))
        distance = float(np.linalg.norm(hand[:3, 3] - problem.target[:3, 3]))
        if problem.elbow is not None:
            distance = max(distance, float(np.linalg.norm(elbow - problem.elbow)))
        turn = pinocchio.log3(hand[:3, :3].T @ problem.target[:3, :3])
        return distance, float(np.linalg.norm(turn)) * problem.turned

    def poses(self, arm: Arm, random: np.random.Generator, count: int) -> list[Array]:
        """Draw poses that the arm can reach."""
        return [self.see(posture)[0] for posture in arm.random(random, (count,))]


def timed(solver: Solver, problem: Problem) -> tuple[Array | None, float]:
    """Return posture and seconds; a solver that raises an error has found nothing."""
    start = time.process_time()
    try:
        posture = solver.solve(problem)
    except Exception:
        posture = None
    return posture, time.process_time() - start


def is_near(answer: Answer, tolerance: tuple[float, float]) -> bool:
    """Return whether distance and angle are below the tolerance."""
    return answer[0] < tolerance[0] and answer[1] < tolerance[1]


def score(
    name: str, answers: Sequence[Answer], tolerance: tuple[float, float], budget: float = BUDGET
) -> Row:
    """Return success in per cent, and quantiles."""
    near = np.array([is_near(answer, tolerance) for answer in answers])
    distance, angle, seconds = np.array(answers).T
    row = {"solver": name, "success": 100 * np.mean(near & (seconds <= budget))}
    row["late"] = 100 * np.mean(near)
    for key, values in (("mm", distance * 1e3), ("rad", angle), ("us", seconds * 1e6)):
        row[key], row[key + "95"] = np.percentile(values, (50, 95), method="lower")
    return row | {"mean": np.mean(seconds) * 1e6, "n": len(answers)}


def play(solvers: Solvers, problems: Sequence[Problem], judge: Judge) -> list[Row]:
    """Let the solvers take turns."""
    answers: dict[str, list[Answer]] = {name: [] for name in solvers}
    for solver in solvers.values():
        timed(solver, problems[0])  # something may be compiled or loaded
    for begin in range(0, len(problems), TURN):
        for name, solver in solvers.items():
            for problem in problems[begin : min(begin + TURN, solver.at_most)]:
                posture, seconds = timed(solver, problem)
                answers[name].append((*judge.errors(posture, problem), seconds))
    return [
        score(name, solver_answers, problems[0].tolerance)
        for name, solver_answers in answers.items()
    ]


def reach(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """Poses that the arm can reach, and their positions alone, at two tolerances."""
    judge, rows = Judge(arm), []
    pairs = list(zip(judge.poses(arm, random, count), arm.random(random, (count,))))
    for turned in (True, False):
        able = {name: solver for name, solver in solvers.items() if turned or solver.positions}
        for tolerance in (LOOSE, TIGHT):
            problems = [Problem(*pair, turned, tolerance) for pair in pairs]
            task = f"{'pose' if turned else 'position'}, {tolerance[0] * 1e3:g} mm"
            rows += [{"task": task} | row for row in play(able, problems, judge)]
    return rows


def batch(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """1,024 poses in one call, at most, where a solver takes them; five calls."""
    judge, rows, count = Judge(arm), [], min(count, 1024)
    for name, solver in solvers.items():
        answers: list[Answer] = []
        for _ in range(5 if hasattr(solver, "solve_all") else 0):
            targets = np.array(judge.poses(arm, random, count))
            starts = arm.random(random, (count,))
            if not answers:
                solver.solve_all(targets[:2], starts[:2])
            begin = time.process_time()
            postures = solver.solve_all(targets, starts)
            each = (time.process_time() - begin) / count
            problems = map(Problem, targets, starts)
            answers += [(*judge.errors(*pair), each) for pair in zip(postures, problems)]
        rows += [score(name, answers, LOOSE)] if answers else []
    return rows


class Rebuilt(Solver):
    """A solver made for the arm without the joint that is locked."""

    def __init__(self, kind: type[Solver], arm: Arm, joint: int, angle: float) -> None:
        begin = time.perf_counter()
        self.inner = kind(arm.fixed(joint, angle))
        self.cost = (time.perf_counter() - begin) * 1e3
        self.joint, self.angle, self.at_most = joint, angle, kind.at_most

    def solve(self, problem: Problem) -> Array | None:
        """Leave the joint out, and put its angle back."""
        start = np.delete(problem.start, self.joint)
        posture = self.inner.solve(replace(problem, start=start, held={}))
        return None if posture is None else np.insert(posture, self.joint, self.angle)


def locked(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """Poses that the arm can reach with one joint locked; each joint in turn."""
    judge, joints = Judge(arm), len(arm.limits)
    rows: dict[str, list[Row]] = {name: [] for name in solvers}
    given_up = set()
    for joint in range(joints):
        angle = float(arm.random(random)[joint])
        able: dict[str, Solver] = {}
        for name, solver in solvers.items():
            if name in given_up:
                continue
            try:
                kind = type(solver)
                able[name] = solver if solver.holds else Rebuilt(kind, arm, joint, angle)
            except Exception as error:
                given_up.add(name)
                print(f"{arm.name} with joint {joint} locked: no {name}: {error!r:.80}")
        problems = []
        for _ in range(count // joints + 1):
            posture, start = arm.random(random, (2,))
            posture[joint] = start[joint] = angle
            problems.append(Problem(judge.see(posture)[0], start, held={joint: angle}))
        for row in play(able, problems, judge):
            row["rebuilt"] = getattr(able[row["solver"]], "cost", 0.0)
            rows[row["solver"]].append(row)
    total = []
    for name, parts in rows.items():
        if parts:
            row = {
                key: np.mean([part[key] for part in parts]) for key in parts[0].keys() - {"solver"}
            }
            share = len(parts) / joints  # a joint without which no solver can be made is a failure
            row |= {"success": row["success"] * share, "late": row["late"] * share}
            total.append({"solver": name} | row | {"n": sum(part["n"] for part in parts)})
    return total


def longer(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """A link 5 % longer than given: solve, see the hand, move the target by the error, repeat.

    A solver that finds nothing, or nothing in time, is asked again from another posture.
    """
    lengths = np.linalg.norm(arm.offsets[1:-1, :3, 3], axis=-1)
    judges = [Judge(arm.stretched(link + 1, 1.05)) for link in np.flatnonzero(lengths > 0.05)]
    answers: dict[str, list[Answer]] = {name: [] for name in solvers}
    looks: dict[str, list[int]] = {name: [] for name in solvers}
    for index in range(count):
        judge = judges[index % len(judges)]
        problem = Problem(judge.poses(arm, random, 1)[0], arm.random(random))
        for name, solver in solvers.items():
            if index < solver.at_most:
                answer, look = correct(arm, solver, problem, judge, np.random.default_rng(index))
                answers[name].append(answer)
                looks[name] += [look] if is_near(answer, LOOSE) else []
    rows = [score(name, solver_answers, LOOSE, np.inf) for name, solver_answers in answers.items()]
    return [row | {"looks": np.mean(looks[row["solver"]] or np.nan)} for row in rows]


def correct(
    arm: Arm, solver: Solver, problem: Problem, judge: Judge, random: np.random.Generator
) -> tuple[Answer, int]:
    """Return the last error that was seen, the seconds of all solutions, and the looks."""
    target, start, total = problem.target, problem.start, 0.0
    asked, errors = target.copy(), (np.inf, np.inf)
    for look in range(1, LOOKS + 1):
        posture, seconds = timed(solver, Problem(asked, start, tolerance=TIGHT))
        total += seconds
        if posture is None or (seconds > BUDGET * 1.2 and solver.is_bounded):
            start = arm.random(random)
            continue
        start, errors = posture, judge.errors(posture, problem)
        if is_near((*errors, total), LOOSE):
            return (*errors, total), look
        seen = judge.see(posture)[0]
        asked[:3, 3] += target[:3, 3] - seen[:3, 3]
        asked[:3, :3] = target[:3, :3] @ seen[:3, :3].T @ asked[:3, :3]
    return (*errors, total), LOOKS


def outside(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """Positions out of reach: how much farther the hand stays than the best that is known."""
    judge, long = Judge(arm), DampedLeastSquares(arm)
    reached = np.array(judge.poses(arm, random, 2000))[:, :3, 3]
    middle = reached.mean(axis=0)
    radius = np.linalg.norm(reached - middle, axis=-1).max()
    able = {name: solver for name, solver in solvers.items() if solver.positions}
    answers: dict[str, list[Answer]] = {name: [] for name in able}
    for index in range(count):
        direction = random.normal(size=3)
        direction *= radius * random.uniform(1.1, 1.5) / np.linalg.norm(direction)
        target = np.eye(4)
        target[:3, 3] = middle + direction
        problem = Problem(target, arm.random(random), turned=False)

        def squared(posture: Array, place: Array = target[:3, 3]) -> float:
            return float(np.sum((judge.see(posture)[0][:3, 3] - place) ** 2))

        known = []
        for start in arm.random(random, (5,)):
            begin = long.solve(replace(problem, start=start), tries=5)
            settings = {"ftol": 1e-14, "gtol": 1e-10}
            known.append(minimize(squared, begin, bounds=arm.limits, options=settings).fun ** 0.5)
        problem_answers = {}
        for name, solver in able.items():
            if index < solver.at_most:
                posture, seconds = timed(solver, problem)
                problem_answers[name] = (judge.errors(posture, problem)[0], 0.0, seconds)
        best = min(*known, *(answer[0] for answer in problem_answers.values()))
        for name, (distance, angle, seconds) in problem_answers.items():
            answers[name].append((distance - best, angle, seconds))
    rows = [score(name, solver_answers, LOOSE) for name, solver_answers in answers.items()]
    for row in rows:
        row["none"] = 100 * np.mean(np.isinf([answer[0] for answer in answers[row["solver"]]]))
    return rows


def path(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """Paths of 500 poses, each solved from the posture before.  No joint has to jump."""
    judge, times = Judge(arm), np.linspace(0, 2 * np.pi, 501)[:, None]
    able = {name: solver for name, solver in solvers.items() if solver.is_bounded}
    answers: dict[str, list[Answer]] = {name: [] for name in able}
    jumps: dict[str, list[float]] = {name: [] for name in able}
    for _ in range(count):
        swing = np.minimum(np.diff(arm.limits).ravel() * 0.4, 1.0)
        swing *= random.uniform(0.5, 1.0, len(swing))
        middle = random.uniform(arm.limits[:, 0] + swing, arm.limits[:, 1] - swing)
        phases = random.integers(1, 3, len(swing)) * times + random.uniform(0, 6, len(swing))
        postures = middle + swing * np.sin(phases)
        targets = [judge.see(posture)[0] for posture in postures[1:]]
        for name, solver in able.items():
            now, largest = postures[0], 0.0
            for target in targets:
                problem = Problem(target, now)
                posture, seconds = timed(solver, problem)
                answers[name].append((*judge.errors(posture, problem), seconds))
                if posture is not None:
                    largest = max(largest, float(np.abs(posture - now).max()))
                    now = posture
            jumps[name].append(largest)
    rows = [score(name, solver_answers, LOOSE) for name, solver_answers in answers.items()]
    for row in rows:
        jump = np.array(jumps[row["solver"]])
        row |= {"jump": np.median(jump), "worst": jump.max(), "smooth": 100 * np.mean(jump < JUMP)}
    return rows


def elbow(arm: Arm, solvers: Solvers, count: int, random: np.random.Generator) -> list[Row]:
    """Poses with the elbow at a point."""
    judge = Judge(arm)
    seen = [judge.see(posture) for posture in arm.random(random, (count,))]
    starts = arm.random(random, (count,))
    problems = [Problem(hand, start, elbow=at) for (hand, at), start in zip(seen, starts)]
    able = {name: solver for name, solver in solvers.items() if solver.elbows}
    return play(able, problems, judge)


TABLES: dict[str, tuple[Callable[..., list[Row]], float]] = {  # with their shares of the problems
    "reach": (reach, 1.0),
    "batch": (batch, 1.0),
    "locked": (locked, 0.1),
    "longer": (longer, 0.05),
    "outside": (outside, 0.02),
    "path": (path, 0.005),
    "elbow": (elbow, 0.1),
}
COLUMNS = {
    "success": "% in 5 ms",
    "late": "% at all",
    "none": "% without an answer",
    "looks": "looks",
    "smooth": "% of paths without a jump",
    "jump": "largest jump, median [rad]",
    "worst": "largest jump, worst [rad]",
    "mm": "error, median [mm]",
    "mm95": "error, 95th percentile [mm]",
    "rad": "error, median [rad]",
    "rad95": "error, 95th percentile [rad]",
    "us": "time, median [µs]",
    "us95": "time, 95th percentile [µs]",
    "rebuilt": "time to build anew [ms]",
    "n": "problems",
}
SUMMARY = {
    "reach": ("success", "us", "us95"),
    "batch": ("success", "us"),
    "locked": ("success", "us", "us95"),
    "longer": ("late", "looks", "us"),
    "outside": ("mm", "mm95", "us"),
    "path": ("smooth", "worst", "us"),
    "elbow": ("success", "us", "us95"),
}


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write all rows as CSV; a cell is empty without an answer, and if it does not apply."""
    names = ["table", "robot", "task", "solver"]
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, *COLUMNS.values()])
        for row in rows:
            cells = [digits(row.get(key)).replace(",", "").replace("–", "") for key in COLUMNS]
            writer.writerow([*(row.get(name, "") for name in names), *cells])


def summary(table: str, rows: Sequence[Row]) -> str:
    """Return a table with a line for each solver and a column for each robot."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        line = cells.setdefault((row.get("task", ""), row["solver"]), {})
        line[row["robot"]] = " / ".join(digits(row[key]) for key in SUMMARY[table])
    names = ["task", "solver"] if table == "reach" else ["solver"]
    lines = [[*names, *robots], ["---"] * (len(names) + len(robots))]
    for key, line in cells.items():
        lines.append([*key[-len(names) :], *(line.get(robot, "–") for robot in robots)])
    heads = " / ".join(COLUMNS[key] for key in SUMMARY[table])
    return f"{heads}:\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def digits(value: float | None) -> str:
    """Return a number to three digits, or a dash."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:,.0f}" if value >= 1000 else f"{value:.4g}" if value > 99 else f"{value:.3g}"


def make_solvers(arm: Arm, names: Iterable[str]) -> dict[str, Solver]:
    """Make the solvers that are installed and that apply to the arm."""
    solvers: dict[str, Solver] = {}
    for kind in SOLVERS:
        name = kind.label or kind.package
        if names and name not in names:
            continue
        try:
            solvers[name] = kind(arm)
        except (ImportError, NotImplementedError) as error:
            print(f"{arm.name}: no {name}: {error}")
    return solvers


def main(arguments: Arguments) -> None:
    """Play the tables, and write them with those of earlier runs in the same folder."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    versions = []
    for package in sorted({kind.package for kind in SOLVERS} | {"daqp", "mujoco", "pin"}):
        with suppress(PackageNotFoundError):
            versions.append(f"{package} {version(package)}")
    text = [f"Python {platform.python_version()}, {', '.join(versions)}; seed {arguments.seed}"]
    for robot in arguments.robots:
        arm = Arm.named(robot)
        solvers = make_solvers(arm, arguments.solvers)
        for name, solver in solvers.items():
            if name != "mmc-gym":
                solver.at_most = min(solver.at_most, arguments.peer_problems)
        for table in arguments.tables:
            begin, (make_rows, share) = time.perf_counter(), TABLES[table]
            random = np.random.default_rng([arguments.seed, list(TABLES).index(table)])
            count = max(1, round(arguments.problems * share))
            rows = [{"robot": robot} | row for row in make_rows(arm, solvers, count, random)]
            path = arguments.out / f"{table}-{robot}-{arguments.seed}.json"
            path.write_text(json.dumps(rows, indent=1, default=float))
            loads = ", ".join(f"{load:.1f}" for load in os.getloadavg())
            print(
                f"{robot} {table}: {time.perf_counter() - begin:.0f} s, loads {loads}", flush=True
            )
    all_rows: list[Row] = []
    for table in TABLES:
        paths = (arguments.out / f"{table}-{robot}-{arguments.seed}.json" for robot in ROBOTS)
        rows = [row for path in paths if path.exists() for row in json.loads(path.read_text())]
        all_rows += [{"table": table} | row for row in rows]
        text += [f"## {table}\n\n{summary(table, rows)}"] if rows else []
    (arguments.out / f"summary-{arguments.seed}.md").write_text("\n\n".join(text) + "\n")
    write_rows(arguments.out / f"rows-{arguments.seed}.csv", all_rows)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
