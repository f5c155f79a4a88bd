import subprocess
import sys

import numpy as np
import pytest

from mechsearch.evaluation.policies import make_policy, policy_names
from mechsearch.pushes.push import straight
from mechsearch.teachers import PAPER_TEACHERS, TEACHERS, PushTeacher, Teacher, make_teacher
from mechsearch.types import TEACHER_KEYS, MechSearchError

FOURTH = """
import numpy as np
from mechsearch.pushes.push import straight
from mechsearch.teachers import PushTeacher


def comb(middle, direction):
    return np.concatenate([straight(middle, direction), straight(middle, -direction)])


def make_comb():
    return PushTeacher(comb)


class Forgetful:
    keys = ("ee_position",)

    def reset(self, rng): ...

    def act(self, obs): ...
"""

WHAT_NAMES_TEACHERS = """
from mechsearch.evaluation.policies import SHAPES
from mechsearch.experiments.plan import SweepPlan
from mechsearch.findings.claims import GOALS, PAPER
from mechsearch.training.config import PRESETS

print([shape.__name__ for shape in SHAPES], SweepPlan(), PAPER, GOALS, PRESETS)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "users_teachers.py").write_text(FOURTH)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("users_teachers", None)


@pytest.mark.parametrize("name", PAPER_TEACHERS)
def test_the_papers_teachers_have_names(name):
    assert isinstance(make_teacher(name), Teacher)


def test_a_teacher_of_ones_own_is_named_like_a_policy(module):
    teacher = make_teacher("users_teachers:make_comb")
    assert teacher.keys == TEACHER_KEYS
    assert isinstance(teacher, Teacher)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("sprial", "unknown teacher 'sprial'; choose among straight, zigzag, spiral, or name"),
        ("users_teachers:missing", "has no function or class 'missing'; it has"),
        ("no_such_module:make", "teacher 'no_such_module:make' cannot be imported"),
        ("users_teachers:Forgetful", "gives a Forgetful without state, restore; a teacher has"),
    ],
)
def test_what_is_no_teacher_is_refused(module, spec, message):
    with pytest.raises(MechSearchError, match=message):
        make_teacher(spec)


def test_a_registered_teacher_is_a_policy_by_name(monkeypatch):
    monkeypatch.setitem(TEACHERS, "fourth", lambda: PushTeacher(straight, 0.5))
    assert policy_names()[-1] == "teacher-fourth"
    made, same = make_policy("teacher-fourth"), PushTeacher(straight, 0.5)
    obs = {
        "ee_position": np.array([-0.2, 0.1, 0.06]),
        "target_offset": np.array([0.2, 0.0, -0.03]),
        "clutter_offsets": np.zeros((1, 3)),
        "clutter_mask": np.zeros(1, np.int8),
    }
    np.testing.assert_array_equal(made.act(obs), same.act(obs))


def test_a_registered_teacher_changes_no_preset_plan_claim_or_look_ahead(module):
    register = (
        "from mechsearch.teachers import TEACHERS; from users_teachers import make_comb; "
        "TEACHERS['comb'] = make_comb"
    )
    printed = [
        subprocess.run(
            [sys.executable, "-c", before + WHAT_NAMES_TEACHERS],
            cwd=module, capture_output=True, text=True, check=True,
        ).stdout
        for before in ("", register)
    ]  # fmt: skip
    assert "spiral" in printed[0]
    assert printed[1] == printed[0]
