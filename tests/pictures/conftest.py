from tests.findings.conftest import evaluations, loose, make_evaluation, models, sweep, write_sweep

__all__ = ["evaluations", "loose", "make_evaluation", "models", "sweep", "write_sweep"]
