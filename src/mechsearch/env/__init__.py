"""The decision process: environment, reward, Gymnasium ids."""
