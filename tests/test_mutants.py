"""Claims about the mutants of `python -m soak mutants`; their tests run there."""

import ast
import json

import pytest

from soak.mutants import EQUIVALENT, ROOT, SUBJECTS, Subject, mutants


@pytest.fixture
def subject(monkeypatch, tmp_path):
    source = "def least(a, b):\n    '''The least.'''\n    return a if a < b else max(b, 1)\n"
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "small.py").write_text(source)
    monkeypatch.setattr("soak.mutants.ROOT", tmp_path)
    return Subject("small", (), ())


def test_each_mutant_differs_in_one_thing(subject):
    found = {mutant.source.splitlines()[-1].strip() for mutant in mutants(subject)}
    assert found == {
        "return None",
        "return a",
        "return max(b, 1)",
        "return a if a <= b else max(b, 1)",
        "return a if a >= b else max(b, 1)",
        "return a if a < b else min(b, 1)",
        "return a if a < b else max(b, 2)",
    }


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.module)
def test_all_mutants_of_a_subject_compile_and_none_is_the_original(subject):
    original = ast.unparse(ast.parse(subject.path.read_text()))
    sources = [mutant.source for mutant in mutants(subject)]
    assert sources
    assert original not in sources
    assert len(set(sources)) == len(sources)
    for source in sources:
        compile(source, subject.module, "exec")
    for test in subject.tests:
        file, _, name = test.partition("::")
        assert f"def {name}" in (ROOT / file).read_text()


def test_every_mutant_listed_as_equivalent_exists_and_has_a_reason():
    names = {mutant.name for subject in SUBJECTS for mutant in mutants(subject)}
    known = json.loads(EQUIVALENT.read_text())
    assert set(known) <= names
    assert all(known.values())
