"""The house: what each kind of addition touches, and that nothing has two names or two meanings."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from docs import architecture

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "mechsearch"

TEACHER = """

def comb(middle, direction):
    return np.concatenate([straight(middle, direction), straight(middle, -direction)])


TEACHERS["comb"] = partial(PushTeacher, comb)
"""

ALGORITHM = """
from dataclasses import dataclass

from mechsearch.algorithm import Algorithm, Line
from mechsearch.evaluation.policies import IdlePolicy


@dataclass(frozen=True)
class Waiting(Algorithm):
    patience: int = 3
    keys = ("ee_position",)

    def begin(self, run, setup, folder):
        return Session()

    def save(self, policy):
        return {}, {}

    def load(self, tensors, facts):
        return IdlePolicy()


class Session:
    executed, policy = 0, IdlePolicy()

    def advance(self, until):
        self.executed += 1
        yield [Line("episode", self.executed, {"return": -0.5})]

    def catch_up(self, step):
        return []

    def archive(self):
        return {}, {"executed": self.executed}

    def restore(self, tensors, facts):
        self.executed = facts["executed"]
"""

POLICY = """
import numpy as np


class Up:
    keys = ("ee_position",)

    def reset(self, rng): ...

    def act(self, obs):
        return np.array([0, 0, 1], np.float32)
"""

COMMAND = """
from dataclasses import dataclass

from mechsearch.cli.command import Command, say


@dataclass(frozen=True)
class Greet(Command):
    def run(self):
        say("good morning")
"""

ADDITIONS = {
    "teacher": {"teachers.py": ("after", TEACHER)},
    "object set": {
        "objects/catalog.py": (
            '    if spec == "household":\n',
            '    if spec == "toys":\n        return household()\n    if spec == "household":\n',
        )
    },
    "policy": {},
    "reward term": {
        "env/reward.py": (
            '        "idleness": idleness(',
            '        "hurry": -0.125,\n        "idleness": idleness(',
        )
    },
    "metric": {
        "evaluation/episodes.py": (
            '"clutter_moved_m", "target_moved_m"),\n)',
            '"clutter_moved_m", "target_moved_m", "first_action"),\n)',
            '        "target_moved_m": record.target_moved.sum(),\n',
            '        "target_moved_m": record.target_moved.sum(),\n'
            '        "first_action": float(record.actions[0, 2]),\n',
        )
    },
    "command": {
        "cli/__init__.py": (
            "\nCOMMANDS = {\n",
            '\nCOMMANDS = {\n    "greet": ("greeting:Greet", "say good morning"),\n',
        )
    },
    "algorithm": {
        "training/config.py": (
            '    "actor-critic": ActorCritic,\n',
            '    "actor-critic": ActorCritic,\n    "waiting": Waiting,\n',
        )
    },
}
"""The files of the package that each addition changes, besides those of its own."""

OWN = {
    "command": {"cli/greeting.py": COMMAND},
    "algorithm": {"waiting/__init__.py": "", "waiting/algorithm.py": ALGORITHM},
}

MOST = {"algorithm": 1, "metric": 1, "command": 1, "reward term": 1, "teacher": 1, "policy": 0}

USE = """
import csv
import sys
from importlib import resources
from pathlib import Path

import mechsearch
from mechsearch.cli import main
from mechsearch.objects.catalog import load_object_set

place = Path(sys.argv[1])
heaps = str(resources.files("mechsearch.heaps") / "household_single.parquet")
assert load_object_set("toys").models
main(["greet"])
mechsearch.train("waiting", heaps, place / "run", actions=4, evaluate_every=4, validation_heaps=1)
main(["evaluate", "teacher-comb", "users:Up", str(place / "run"), "--limit", "1", "--workers", "1",
      "--max-actions", "2", "--out", str(place / "scores"), "--summary", str(place / "s.csv")])
main(["report", str(place / "scores"), str(place / "run"), "--no-pictures", "--out",
      str(place / "r.html")])
assert "first action" in (place / "r.html").read_text()
rows = list(csv.DictReader((place / "s.csv").open()))
found = {(r["variant"], r["metric"]): float(r["mean"]) for r in rows}
assert found["users:Up", "first_action"] == 1.0
assert {variant for variant, _ in found} == {"teacher-comb", "users:Up", "waiting"}
# Two actions, each 0.5 for idleness and the new term.
assert abs(found["waiting", "reward"] + 2 * 0.625) < 1e-9
"""


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A copy of the package with one of each kind added, and how many of its files changed."""
    place = tmp_path_factory.mktemp("house")
    package = place / "mechsearch"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    for changes in ADDITIONS.values():
        for name, (*edits,) in changes.items():
            text = (package / name).read_text()
            if edits[0] == "after":
                text += edits[1]
            else:
                for old, new in zip(edits[::2], edits[1::2], strict=True):
                    assert text.count(old) == 1, (name, old)
                    text = text.replace(old, new)
            (package / name).write_text(text)
    for files in OWN.values():
        for name, text in files.items():
            (package / name).parent.mkdir(exist_ok=True)
            (package / name).write_text(text)
    teachers = package / "teachers.py"
    teachers.write_text("import numpy as np\n" + teachers.read_text())
    config = package / "training" / "config.py"
    line = "from mechsearch.waiting.algorithm import Waiting\n"
    config.write_text(line + config.read_text())
    (place / "users.py").write_text(POLICY)
    return place


def test_one_of_each_kind_is_added_and_works(house, tmp_path):
    pytest.importorskip("torch")
    done = subprocess.run(
        [sys.executable, "-c", USE, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(house)}, cwd=house,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "good morning" in done.stdout


@pytest.mark.parametrize("kind", MOST)
def test_an_addition_changes_no_more_files_than_it_should(kind):
    assert len(ADDITIONS[kind]) <= MOST[kind]


def test_no_name_has_two_meanings():
    twins = architecture.twins(architecture.modules(PACKAGE))
    assert twins["classes"] == []
    assert len(twins["functions"]) + len(twins["constants"]) < 5


def test_a_module_knows_few_others():
    assert architecture.measured(PACKAGE)["own imports per module"] < 4.25


def test_the_picture_shows_every_room():
    shown = {room for row in architecture.rows() for room in row}
    assert shown >= {architecture.room_of(name) for name in architecture.modules(PACKAGE)} - {
        "mechsearch"
    }
