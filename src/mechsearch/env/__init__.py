"""The decision process: environment, reward, trials of pushes."""
