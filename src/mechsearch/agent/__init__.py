"""The learner: networks, replay, actor-critic updates and guidance. It knows no environment."""
