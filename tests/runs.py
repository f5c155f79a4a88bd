"""Configurations of runs, changed by the names of their options alone."""

from dataclasses import fields, replace


def changed(config, **changes):
    """Return a run's configuration with changes to it, its schedule, task or algorithm."""
    for part in ("schedule", "task", "algorithm"):
        own = {f.name for f in fields(getattr(config, part))}
        mine = {name: changes.pop(name) for name in list(changes) if name in own}
        config = (
            replace(config, **{part: replace(getattr(config, part), **mine)}) if mine else config
        )
    return replace(config, **changes)
