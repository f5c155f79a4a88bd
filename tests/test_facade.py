import subprocess
import sys

import pytest

import mechsearch


def test_every_public_name_is_found_and_they_are_sorted():
    assert mechsearch.__all__ == sorted(mechsearch.__all__)
    assert set(mechsearch._PLACES) == set(mechsearch.__all__)
    for name in mechsearch.__all__:
        assert getattr(mechsearch, name) is not None


def test_an_unknown_name_is_no_attribute():
    with pytest.raises(AttributeError, match="'nonsense'"):
        _ = mechsearch.nonsense


@pytest.mark.parametrize("module", ["env.register", "evaluation.rollout", "report.contents", "cli"])
def test_the_base_install_needs_no_torch(module):
    code = f"import sys, mechsearch.{module}; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
