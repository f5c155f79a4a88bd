"""The paper's actor-critic: networks, replay, learner, guidance, collection (PyTorch)."""
