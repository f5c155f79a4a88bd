"""Nothing imitated: `mechsearch train asymmetric_sac:AsymmetricSac --heaps HEAPS --out RUN`.

Soft actor-critic (Haarnoja et al., 2018) in which only the critic knows what a simulator knows
(Pinto et al., 2018). An action is a move: a way of up to 20 cm, straight, in nudges of 5 cm, after
which the actor looks again. Half of what is learnt from, teachers did; nobody is drawn to it.
A second actor, which knows what the critic knows, says what follows a move.
"""

import copy
import json
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import nn

from mechsearch.actor_critic.symmetry import SYMMETRIES, VECTORS, transform
from mechsearch.algorithm import Algorithm, Line
from mechsearch.files.tensors import fill, fill_optimizer, optimizer_tensors, part, prefixed
from mechsearch.teachers import PAPER_TEACHERS
from mechsearch.types import ACTION_LENGTH, ACTOR_KEYS, IMAGE_KEYS, MechSearchError, select

CROP = 32
"""Side of what the actor sees of its images [px]: half of theirs."""


@dataclass(frozen=True)
class AsymmetricSac(Algorithm):
    """Its options.

    Attributes:
        nudges: In a move, at most.
        entropy: Of a move, in the mean [nats].
        gamma: Discount of a nudge.
        updates: Of the critic for each nudge.
        batch: Moves in an update of the critic.
        rates: Of the critic and the privileged actor, and of the actor that sees.
        warmup: Nudges before the first update.
        taught: Nudges in the beginning that are the teachers' alone; later they and both actors
            take turns, by episodes drawn at random.
    """

    nudges: int = 4
    entropy: float = -1.5
    gamma: float = 0.97
    updates: int = 3
    batch: int = 128
    rates: tuple[float, float] = (3e-4, 1e-3)
    warmup: int = 300
    taught: int = 800
    keys, teachers = ACTOR_KEYS, PAPER_TEACHERS

    def check(self, task):
        """Refuse a view that does not turn as the task does, or is of another size."""
        if (task.camera, task.image_size) != ("overhead", 2 * CROP):
            raise MechSearchError(
                f"camera is {task.camera!r} and image_size {task.image_size}; the actor learns "
                f"from the overhead camera's images of {2 * CROP} px"
            )

    def begin(self, run, setup, folder):
        """Return a session at its beginning."""
        torch.manual_seed(run.seed)
        torch.set_num_threads(run.schedule.threads)
        return MoveSession(self, setup, run.seed, 2 * run.schedule.actions + 100)

    def save(self, policy):
        """Return an actor's weights, and how far it goes."""
        facts = {"reach": policy.reach, "bounds": np.asarray(policy.bounds).tolist()}
        return dict(policy.actor.state_dict()), facts

    def load(self, tensors, facts):
        """Return the actor that `save` was given, as a policy."""
        fill(actor := Actor(), tensors)
        return MovePolicy(actor, facts["reach"], facts["bounds"])


class Move:
    """A way to a place, and the nudges that it still takes."""

    def __init__(self, ee, action, reach, bounds):
        action = action / max(1.0, float(np.linalg.norm(action)))
        self.goal = np.clip(ee + reach * action, *bounds)
        self.left = np.ceil(np.linalg.norm(self.goal - ee) / ACTION_LENGTH - 1e-3)

    def done(self, ee):
        """Return whether it is over at a place (3,) [m]."""
        return self.left <= 0 or np.linalg.norm(self.goal - ee) < 0.004

    def nudge(self, ee):
        """Return the next action (3,)."""
        self.left -= 1
        step = (self.goal - ee) / ACTION_LENGTH
        return (step / max(1.0, float(np.linalg.norm(step)))).astype(np.float32)


class MovePolicy:
    """An actor's moves, drawn as it learnt to draw them: the best guess alone stays put."""

    keys = ACTOR_KEYS

    def __init__(self, actor, reach, bounds):
        self.actor, self.reach, self.bounds = copy.deepcopy(actor).eval(), reach, bounds

    def reset(self, rng):
        """Begin an episode."""
        self.rng, self.move = rng, None

    def act(self, obs):
        """Return the next action (3,) of the present move, or of a new one."""
        ee = np.asarray(obs["ee_position"], np.float64)
        if self.move is None or self.move.done(ee):
            seen = {k: torch.as_tensor(v)[None] for k, v in select(obs, ACTOR_KEYS).items()}
            with torch.inference_mode():
                mean, deviation = (x[0].numpy() for x in self.actor(seen))
            drawn = np.tanh(mean + deviation * self.rng.standard_normal(3))
            self.move = Move(ee, drawn, self.reach, self.bounds)
        return self.move.nudge(ee)


def dense(*widths):
    """Return layers with normalised ReLUs, and a last one that begins near zero."""
    layers = []
    for a, b in pairwise(widths[:-1]):
        layers += [nn.Linear(a, b), nn.LayerNorm(b), nn.ReLU()]
    layers.append(nn.Linear(*widths[-2:]))
    nn.init.uniform_(layers[-1].weight, -3e-3, 3e-3)
    return nn.Sequential(*layers)


def normal(outputs):
    """Return mean and standard deviation (B, 3) that a network's outputs (B, 6) stand for."""
    return outputs[:, :3], (2 * outputs[:, 3:] - 1.2).clamp(-4, 0.5).exp()


def draw(mean, deviation):
    """Return actions (B, 3) in [-1, 1], and the logarithms of their densities (B,)."""
    noise = torch.randn_like(mean)
    action = torch.tanh(mean + deviation * noise)
    straight = -0.5 * noise.square() - deviation.log() - 0.5 * np.log(2 * np.pi)
    return action, (straight - torch.log1p(1e-6 - action.square())).sum(-1)


class Actor(nn.Module):
    """Sees heights and the target about the middle of what it sees of it, or about itself."""

    def __init__(self):
        super().__init__()
        sizes = ((3, 4, 2), (32, 3, 2), (32, 3, 1))
        tower = [x for c, k, s in sizes for x in (nn.Conv2d(c, 32, k, s, 1), nn.ReLU())]
        self.tower = nn.Sequential(*tower, nn.Flatten()).to(memory_format=torch.channels_last)
        self.places = nn.Sequential(nn.Linear(9, 64), nn.ReLU())
        self.trunk = dense(CROP * CROP * 2 + 64, 256, 256, 6)

    def forward(self, obs):
        """Return mean and deviation (B, 3) of moves, before the tanh, for observations (B, ...)."""
        offsets, ee = obs["position_image"].float(), obs["ee_position"].float()
        height = 10 * (1 - obs["depth"].float())
        seen = (offsets.abs().amax(1, keepdim=True) > 0).float()
        count = seen.sum((1, 2, 3))
        share = 1 / count.clamp_min(1)
        offset = offsets.sum((2, 3)) * share[:, None]
        side = torch.arange(float(seen.shape[-1]))
        # The view is 70 cm wide; rows run along -y.
        own = (len(side) - 1) / 2 + ee[:, :2] * torch.tensor([1.0, -1.0]) * len(side) / 0.7
        column, row = (
            torch.where(count == 0, own[:, i], (seen * along).sum((1, 2, 3)) * share)
            .round().long().clamp(0, len(side) - 1)[:, None] + torch.arange(CROP)
            for i, along in enumerate((side, side[:, None]))
        )  # fmt: skip
        images = torch.cat([height, seen, height - 10 * ee[:, 2].view(-1, 1, 1, 1)], 1)
        images = nn.functional.pad(images, [CROP // 2] * 4)
        every = torch.arange(len(images))[:, None, None]
        crop = images[every, :, row[:, :, None], column[:, None]].permute(0, 3, 1, 2)
        far, size = offset.norm(dim=1, keepdim=True), count[:, None].sqrt() / len(side)
        near = torch.exp(-(far / 0.08).square())
        places = torch.cat([8 * offset, 8 * far, near, 8 * size, 4 * ee], 1)
        return normal(self.trunk(torch.cat([self.tower(crop), self.places(places)], 1)))


def about(offset, radius):
    """Return features (..., 5) of an offset (..., 3) [m] to an object of some radius [m]."""
    far = offset.norm(dim=-1, keepdim=True)
    return torch.cat([10 * offset, 10 * (far - radius), torch.exp(-(far / 0.06).square())], -1)


class Objects(nn.Module):
    """Features of objects that do not depend on their order (Zaheer et al., 2017)."""

    def __init__(self, width):
        super().__init__()
        first = (nn.Linear(width, 64), nn.LayerNorm(64), nn.ReLU())
        self.each = nn.Sequential(*first, nn.Linear(64, 64), nn.ReLU())

    def forward(self, features, there):
        """Return features (B, 128) of those of objects (B, N, width) that are there (B, N)."""
        found = self.each(features) * there[..., None]
        return torch.cat([found.sum(1) / 4, found.amax(1)], -1)


class Privileged(nn.Module):
    """Mean and deviation of moves, by what a simulator knows."""

    def __init__(self):
        super().__init__()
        self.objects, self.trunk = Objects(10), dense(138, 256, 256, 6)

    def forward(self, state):
        """Return what `Actor` returns."""
        radius, target = state["radii"][..., None], state["target_offset"]
        beside = state["clutter_offsets"] - target[:, None]
        far = beside.norm(dim=-1, keepdim=True)
        own = about(state["clutter_offsets"], radius)
        each = torch.cat([own, 10 * beside, 10 * far, 20 * radius], -1)
        whole = torch.cat(
            [self.objects(each, state["clutter_mask"]), about(target, state["radius"]),
             4 * state["ee_position"], 20 * state["radius"], state["occlusion"]], -1,
        )  # fmt: skip
        return normal(self.trunk(whole))


class Critic(nn.Module):
    """Four values of a move: where it passes the objects, and where it ends."""

    def __init__(self, reach, bounds):
        super().__init__()
        self.reach, (self.low, self.high) = reach, torch.tensor(np.asarray(bounds)).float()
        self.objects = Objects(21)
        self.heads = nn.ModuleList(dense(155, 256, 256, 1) for _ in range(4))

    def forward(self, state, action):
        """Return values (4, B) of moves (B, 3)."""
        ee, target = state["ee_position"], state["target_offset"]
        goal = ee + self.reach * action / action.norm(dim=-1, keepdim=True).clamp_min(1)
        # The border stops the move, and not the gradient.
        goal = goal + (torch.clamp(goal, self.low, self.high) - goal).detach()
        way = (goal - ee)[:, None]
        radius, radii = state["radius"], state["radii"][..., None]
        offsets, length = state["clutter_offsets"], way.square().sum(-1, keepdim=True) + 1e-6

        def passed(offset):
            share = ((offset * way).sum(-1, keepdim=True) / length).clamp(0, 1)
            return offset - share * way, share

        beside = offsets - target[:, None]
        (aside, share), (past, along) = passed(offsets), passed(target[:, None])
        each = [about(aside, radii), share, about(offsets - way, radii), about(offsets, radii)]
        each += [10 * beside, 10 * beside.norm(dim=-1, keepdim=True), 20 * radii]
        whole = [self.objects(torch.cat(each, -1), state["clutter_mask"])]
        whole += [about(x, radius) for x in (target - way[:, 0], target, past[:, 0])]
        whole += [along[:, 0], way[:, 0] / self.reach, 4 * ee, 4 * goal, 20 * radius]
        features = torch.cat([*whole, state["occlusion"]], -1)
        return torch.stack([head(features)[:, 0] for head in self.heads])


class MoveSession:
    """What was done, row by row, and networks that learn from it after every nudge."""

    def __init__(self, options, setup, seed, rows):
        self.options, self.setup, self.rng = options, setup, np.random.default_rng(seed)
        space, self.reach = setup.env.config.workspace, options.nudges * ACTION_LENGTH
        self.bounds = [space.clip(np.full(3, end)) for end in (-np.inf, np.inf)]
        self.radii = {name: model.radius for name, model in setup.env.objects.models.items()}
        critic = Critic(self.reach, self.bounds)
        self.nets = {"critic": critic, "privileged": Privileged(), "actor": Actor()}
        self.slow = {k: copy.deepcopy(v).requires_grad_(False) for k, v in self.nets.items()}
        rates = dict(zip(self.nets, (options.rates[0], *options.rates), strict=True))
        self.adam = {k: torch.optim.Adam(v.parameters(), rates[k]) for k, v in self.nets.items()}
        # Of the entropy, for each actor.
        self.prices = {k: nn.Parameter(torch.tensor(np.log(0.02))) for k in rates if k != "critic"}
        self.adam |= {f"price of {k}": torch.optim.Adam([p], 3e-3) for k, p in self.prices.items()}
        spaces = setup.env.observation_space
        shapes = {key: (spaces[key].shape, spaces[key].dtype) for key in spaces}
        count = spaces["clutter_mask"].shape
        shapes |= {"radii": (count, "f4"), "radius": ((1,), "f4"), "occlusion": ((1,), "f4")}
        shapes |= {"action": ((3,), "f4"), "reward": ((), "f4"), "going": ((), "f4")}
        # Nudges ahead that go on straight; 0 in an episode's last row, which has no action.
        shapes |= {"ahead": ((), "i8"), "taught": ((), "?")}
        self.rows = {k: np.zeros((rows, *shape), kind) for k, (shape, kind) in shapes.items()}
        self.executed, self.used = 0, 0

    policy = property(lambda self: MovePolicy(self.slow["actor"], self.reach, self.bounds))

    def advance(self, until):
        """Go through one episode, learning after each nudge."""
        options, env, rng = self.options, self.setup.env, self.rng
        heap, *seeds = int(rng.choice(self.setup.heaps)), *rng.integers(2**31, size=2).tolist()
        who = ("privileged", "actor", "teacher")[rng.integers(3)]
        who = "teacher" if self.executed < options.taught else who
        teacher = list(self.setup.teachers.values())[rng.integers(len(self.setup.teachers))]
        teacher.reset(np.random.default_rng(seeds[0]))
        obs, info = env.reset(seed=seeds[1], options={"heap": heap})
        first, move, going, total = self.used, None, True, 0.0
        while going:
            self._keep(obs, info, heap)
            if who == "teacher":
                action = teacher.act(select(obs, teacher.keys))
            else:
                if move is None or move.done(obs["ee_position"]):
                    seen = self._images if who == "actor" else self._states
                    with torch.no_grad():
                        drawn = draw(*self.nets[who](seen([self.used - 1])))[0]
                    move = Move(obs["ee_position"], drawn[0].numpy(), self.reach, self.bounds)
                action = move.nudge(obs["ee_position"])
            obs, reward, ended, cut, info = env.step(action)
            going, total = not (ended or cut), total + reward
            row = self.used - 1
            for key, value in (("action", action), ("reward", reward), ("going", not ended)):
                self.rows[key][row] = value
            self.rows["taught"][row] = who == "teacher"
            self.executed += 1
            self._learn()
        if not info["failure"]:
            # Else the last nudge is not learnt from, and its beginning ends the episode.
            self._keep(obs, info, heap)
        self._look_ahead(first)
        values = {"heap": heap, "who": who, "return": total, "end": info["end"]}
        yield [Line("episode", self.executed, values)]

    def _keep(self, obs, info, heap):
        """Begin a row by what is seen, and what else a simulator knows."""
        row, heap = self.used, self.setup.env.heaps[heap]
        radii = [self.radii[name] for name in heap.objects]
        rest = radii[: heap.target] + radii[heap.target + 1 :]
        for key, value in obs.items():
            self.rows[key][row] = value
        self.rows["radii"][row, : len(rest)] = rest
        self.rows["radius"][row] = radii[heap.target]
        self.rows["occlusion"][row] = info["occlusion"]
        self.used += 1

    def _look_ahead(self, first):
        """Say of each nudge of an episode how many from it on are one straight move."""
        places, last = self.rows["ee_position"], self.used - 1
        for row in range(first, last):
            longest = min(self.options.nudges, last - row)
            steps = np.linalg.norm(np.diff(places[row : row + longest + 1], axis=0), axis=1)
            away = np.linalg.norm(places[row + 1 : row + longest + 1] - places[row], axis=1)
            straight = away >= np.cumsum(steps) / 1.1 - 1e-4
            self.rows["ahead"][row] = max(1, np.argmin([*straight, False]))

    def _states(self, rows, symmetry=SYMMETRIES[0]):
        """Return what a simulator knows in rows, turned."""
        return {
            key: symmetry.of(key, value) if key in VECTORS else value
            for key in (*self.setup.env.observation_space, "radii", "radius", "occlusion")
            if key not in IMAGE_KEYS
            for value in [torch.as_tensor(self.rows[key][rows]).float()]
        }

    def _images(self, rows, symmetry=SYMMETRIES[0]):
        """Return what the actor sees in rows, turned."""
        return transform({k: torch.as_tensor(self.rows[k][rows]) for k in ACTOR_KEYS}, symmetry)

    def _learn(self):
        """Take the updates of one nudge, from episodes that are over."""
        rows = np.flatnonzero(self.rows["ahead"][: self.used])
        if len(rows) < self.options.warmup:
            return
        taught = rows[self.rows["taught"][rows]]
        shown = taught if len(taught) else rows
        half = self.options.batch // 2

        def drawn():
            return np.concatenate([self.rng.choice(some, half) for some in (shown, rows)])

        for _ in range(self.options.updates):
            self._improve_critic(drawn())
        self._improve("privileged", drawn())
        self._improve("actor", self.rng.choice(rows, half))

    def _moves(self, rows):
        """Return moves that began in rows, as far as they went straight or less, and their ends."""
        kept, most = self.rows, self.rows["ahead"][rows]
        some = 1 + np.floor(self.rng.uniform(size=len(rows)) * most).astype(int)
        length = np.where(self.rng.uniform(size=len(rows)) < 0.7, most, some)
        reward, discount = np.zeros((2, len(rows)), np.float32)
        discount += 1
        for i in range(self.options.nudges):
            on = i < length
            row = np.where(on, rows + i, rows)
            reward += on * discount * kept["reward"][row]
            discount *= np.where(on, self.options.gamma * kept["going"][row], 1)
        ends = rows + length
        # Of a single nudge the command is known; what blocks it need not be in it.
        went = (kept["ee_position"][ends] - kept["ee_position"][rows]) / self.reach
        told = kept["action"][rows] / self.options.nudges
        action = np.where((length == 1)[:, None], told, went).astype(np.float32)
        return action, 0.1 * reward, discount, ends

    def _improve_critic(self, rows):
        """Take a step towards what a move brought and what the privileged actor makes of it."""
        action, reward, discount, ends = self._moves(rows)
        symmetry = SYMMETRIES[self.rng.integers(8)]
        with torch.no_grad():
            after = self._states(ends, symmetry)
            move, density = draw(*self.slow["privileged"](after))
            follows = self.slow["critic"](after, move)[torch.randperm(4)[:2]].amin(0)
            follows -= self.prices["privileged"].exp() * density
            value = torch.as_tensor(reward) + torch.as_tensor(discount) * follows
        found = self.nets["critic"](
            self._states(rows, symmetry), symmetry.of_vectors(torch.as_tensor(action))
        )
        self._step("critic", 4 * (found - value).square().mean())

    def _improve(self, who, rows):
        """Take a step of an actor towards moves of higher value, and as random as is asked for."""
        symmetry = SYMMETRIES[self.rng.integers(8)]
        state = self._states(rows, symmetry)
        seen = self._images(rows, symmetry) if who == "actor" else state
        mean, deviation = self.nets[who](seen)
        move, density = draw(mean, deviation)
        self.nets["critic"].requires_grad_(False)
        value = self.nets["critic"](state, move).mean(0)
        self.nets["critic"].requires_grad_(True)
        price = self.prices[who]
        gain = value - price.exp().detach() * density
        self._step(who, -gain.mean() / value.detach().abs().mean() + 3e-3 * mean.square().mean())
        self._step(
            f"price of {who}", -price.exp() * (density.detach().mean() + self.options.entropy)
        )

    def _step(self, name, loss):
        self.adam[name].zero_grad()
        loss.backward()
        if name == "critic":
            nn.utils.clip_grad_norm_(self.nets[name].parameters(), 10.0)
        self.adam[name].step()
        if name in self.slow:
            own, slow = (list(x[name].parameters()) for x in (self.nets, self.slow))
            with torch.no_grad():
                torch._foreach_lerp_(slow, own, 0.005)

    def catch_up(self, step):
        """Do nothing: all is learnt at once."""
        return []

    def archive(self):
        """Return all that `restore` needs."""
        tensors = {"torch": torch.get_rng_state()}
        for kind, nets in (("nets", self.nets), ("slow", self.slow)):
            for name, net in nets.items():
                tensors |= prefixed(f"{kind}/{name}", net.state_dict())
        for name, adam in self.adam.items():
            tensors |= prefixed(f"adam/{name}", optimizer_tensors(adam))
        tensors |= {f"prices/{name}": price.detach() for name, price in self.prices.items()}
        tensors |= {f"rows/{k}": torch.as_tensor(v[: self.used]) for k, v in self.rows.items()}
        facts = {"executed": self.executed, "used": self.used}
        return tensors, facts | {"rng": json.dumps(self.rng.bit_generator.state)}

    def restore(self, tensors, facts):
        """Go on where `archive` was called."""
        torch.set_rng_state(tensors["torch"])
        for kind, nets in (("nets", self.nets), ("slow", self.slow)):
            for name, net in nets.items():
                fill(net, part(tensors, f"{kind}/{name}"))
        for name, adam in self.adam.items():
            fill_optimizer(adam, part(tensors, f"adam/{name}"))
        for name, price in self.prices.items():
            price.data.copy_(tensors[f"prices/{name}"])
        self.executed, self.used = facts["executed"], facts["used"]
        for key, value in part(tensors, "rows").items():
            self.rows[key][: self.used] = value.numpy()
        self.rng.bit_generator.state = json.loads(facts["rng"])
