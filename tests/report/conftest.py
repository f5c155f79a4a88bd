from tests.findings.conftest import (
    evaluations,
    loose,
    make_evaluation,
    make_retrieval,
    models,
    retrievals,
    sweep,
    write_sweep,
)

__all__ = [
    "evaluations",
    "loose",
    "make_evaluation",
    "make_retrieval",
    "models",
    "retrievals",
    "sweep",
    "write_sweep",
]
