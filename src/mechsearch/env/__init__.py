"""The tasks as decision processes: environments, decisions, rewards, trials of pushes."""

from mechsearch.env.decision import Decision, reachable
from mechsearch.env.heap_env import HeapEnv, make_env
from mechsearch.env.retrieve_env import RetrieveEnv, make_retrieve_env
from mechsearch.env.reward import RewardConfig
from mechsearch.env.task import (
    HeapEnvConfig,
    RetrievalTask,
    RetrieveConfig,
    TaskConfig,
    task_from_json,
)
from mechsearch.env.trial import (
    Propose,
    Rollout,
    from_start,
    imageless,
    once,
    pushing,
    roll_out,
    through,
)
