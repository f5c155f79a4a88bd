"""What a robot's computer installs: small, whole by itself, and the same as elsewhere."""

import os
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
OWN = ROOT / "packaging" / "robot"

pytest.importorskip("onnxruntime")
pytest.importorskip("rosbags")


def described(folder):
    return tomllib.loads((folder / "pyproject.toml").read_text())


def of_extras(project):
    """What optional parts ask for."""
    return [text for extra in project["optional-dependencies"].values() for text in extra]


def closure(requirements):
    """What is installed of some requirements, and of theirs, by name."""
    found, wanted = {}, [Requirement(text) for text in requirements]
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        here = not requirement.marker or requirement.marker.evaluate({"extra": ""})
        if here and name not in found:
            found[name] = distribution(name)
            wanted += map(Requirement, found[name].requires or [])
    return found


def test_it_takes_less_than_400_mb():
    parts = closure(described(OWN)["project"]["dependencies"])
    files = [file.locate() for part in parts.values() for file in part.files or []]
    # What is compiled on installation is not counted by every installer.
    size = sum(Path(file).stat().st_size for file in files if Path(file).is_file())
    assert 100e6 < size < 400e6
    assert not {"torch", "mujoco-core", "embreex", "trimesh", "pyarrow", "matplotlib"} & set(parts)


def test_version_and_requirements_are_those_of_the_whole():
    own, whole = described(OWN)["project"], described(ROOT)["project"]
    assert own["version"] == f"{whole['version']}+robot"
    extras = whole["optional-dependencies"]
    known = {*whole["dependencies"], *extras["robot"], *extras["calibration"], *extras["dds"]}
    assert {*own["dependencies"], *of_extras(own)} <= known


def test_its_modules_need_nothing_else(tmp_path):
    wheel = described(OWN)["tool"]["hatch"]["build"]["targets"]["wheel"]
    for source, target in wheel["force-include"].items():
        (tmp_path / target).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (OWN / source).is_dir() else shutil.copy
        copy(OWN / source, tmp_path / target)
    own = described(OWN)["project"]
    parts = [*own["dependencies"], *of_extras(own)]
    code = f"""
import sys
from importlib.metadata import packages_distributions

owners, allowed = packages_distributions(), {sorted(closure(parts))!r}

class Refused:
    def find_spec(self, name, path=None, target=None):
        names = [n.lower().replace("_", "-").replace(".", "-") for n in owners.get(name, [])]
        if names and not set(names) & {{*allowed, "mechsearch"}}:
            raise ImportError(f"{{name}} is not among what is installed")

sys.meta_path.insert(0, Refused())
import mechsearch
assert mechsearch.__file__.startswith({str(tmp_path)!r}), mechsearch.__file__
from mechsearch.cli import calibrating, main, robot
from mechsearch.robot import bags, calibration, controller, policy
try:
    import cyclonedds
except ImportError:
    pass
else:
    from mechsearch.robot import node
main([])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    listed = [line.split("  ")[1] for line in done.stdout.splitlines() if line.startswith("  ")]
    assert listed == ["robot play", "robot calibrate", "robot check-calibration"]
